"""Folders beyond which nothing is read or written, whatever a caller asks for."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from realsim.core.errors import RealsimError


class Roots:
    """The folders that were named at the start; links are followed before anything is compared."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """Raises RealsimError where none is given, or one is no folder."""
        if not folders:
            raise RealsimError("no folder given", expected="--root FOLDER, one or more")
        for folder in folders:
            if not folder.is_dir():
                raise RealsimError("not a folder", file=folder, expected="--root FOLDER, one or more that exist")
        self.folders = tuple(folder.resolve() for folder in folders)

    def path(self, text: str) -> Path:
        """A path in one of the folders, its links followed; a relative one starts at the first folder.

        Raises:
            RealsimError: it leads out of all of them, or cannot be followed.
        """
        try:
            found = (self.folders[0] / text).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # links in a circle, a zero byte
            raise RealsimError("the path cannot be followed", file=text, found=str(error)) from error
        if not self._holds(found):
            raise RealsimError(
                "the path leads out of the folders that may be used",
                file=text,
                expected=f"a path in {' or '.join(map(str, self.folders))}",
                found=str(found),
            )
        return found

    def source(self, text: str) -> Path:
        """The same for an input that is there; no link in it may lead out either.

        Raises:
            RealsimError: it is absent, or it or a link in it leads out.
        """
        found = self.path(text)
        if not found.exists():
            raise RealsimError("there is no such file or folder", file=found)
        waiting, seen = [found], set()
        while waiting:
            place = waiting.pop()
            if place in seen or not place.is_dir():
                continue
            seen.add(place)
            with os.scandir(place) as entries:
                for entry in entries:
                    if entry.is_symlink():
                        waiting.append(self.path(entry.path))
                    elif entry.is_dir(follow_symlinks=False):
                        waiting.append(Path(entry.path))
        return found

    def _holds(self, path: Path) -> bool:
        return any(path.is_relative_to(folder) for folder in self.folders)
