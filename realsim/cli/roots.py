"""Folders beyond which nothing is read or written, whatever a caller asks for."""

import os
from collections.abc import Sequence
from pathlib import Path

from realsim.core.errors import RealsimError

LONGEST = 4096
"""Characters of a path: PATH_MAX of Linux."""
MOST_ENTRIES = 1_000_000
"""Files and folders in an input: three times those of an hour of depth and colour at 30 frames a second."""


class Roots:
    """The folders that were named at the start; links are followed before anything is compared."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """Raises RealsimError where none is given, or one is no folder."""
        if not folders:
            raise RealsimError(
                "no folder given", expected="--root FOLDER, one or more", hint="realsim mcp --root FOLDER"
            )
        for folder in folders:
            if not folder.is_dir():
                raise RealsimError(
                    "not a folder", file=folder, expected="--root FOLDER that exists", hint="check the path"
                )
        self.folders = tuple(folder.resolve() for folder in folders)

    def path(self, text: str) -> Path:
        """A path in one of the folders, its links followed; a relative one starts at the first folder.

        Raises:
            RealsimError: it leads out of all of them, or cannot be followed.
        """
        expected = f"a path in {' or '.join(map(str, self.folders))}"
        if not text.strip():
            raise RealsimError("the path is empty", expected=expected, hint="give the path of a file or folder")
        if len(text) > LONGEST:  # beyond what a system takes; it is not repeated in the answer
            raise RealsimError(
                "the path is too long",
                expected=f"at most {LONGEST} characters",
                found=f"{len(text)} characters",
                hint="give the path of a file or folder, not its content",
            )
        try:
            found = (self.folders[0] / text).resolve()
            found.exists()
        except (OSError, RuntimeError, ValueError) as error:  # links in a circle, a zero byte, a name that is too long
            raise RealsimError(
                "the path cannot be followed", file=text[:200], expected=expected, found=str(error)[:200]
            ) from error
        if not self._holds(found):
            raise RealsimError(
                "the path leads out of the folders that may be used",
                file=text,
                expected=expected,
                found=str(found),
                hint="start it with the folder that holds it: realsim app FOLDER, realsim mcp --root FOLDER",
            )
        return found

    def source(self, text: str) -> Path:
        """The same for an input that is there; no link in it may lead out either.

        Raises:
            RealsimError: it is absent, holds more than MOST_ENTRIES, or it or a link in it leads out.
        """
        found = self.path(text)
        if not found.exists():
            raise RealsimError("there is no such file or folder", file=found, hint="check the path")
        waiting, seen, count = [found], set(), 0
        while waiting:
            place = waiting.pop()
            if place in seen or not place.is_dir():
                continue
            seen.add(place)
            with os.scandir(place) as entries:
                for entry in entries:
                    count += 1
                    if count > MOST_ENTRIES:
                        raise RealsimError(
                            "the folder holds too many files",
                            file=found,
                            expected=f"at most {MOST_ENTRIES} files and folders",
                            hint="give the folder of one capture or case",
                        )
                    if entry.is_symlink():
                        waiting.append(self.path(entry.path))
                    elif entry.is_dir(follow_symlinks=False):
                        waiting.append(Path(entry.path))
        return found

    def _holds(self, path: Path) -> bool:
        return any(path.is_relative_to(folder) for folder in self.folders)
