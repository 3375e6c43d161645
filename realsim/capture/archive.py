"""Members of a zip archive as bytes: with limits, never unpacked to disk, an archive that lies is refused."""

import zipfile
import zlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath

from realsim.core.errors import CaptureError
from realsim.core.files import check_size

MAX_ARCHIVE_BYTES = 16 * 2**30
MAX_MEMBERS = 500_000
DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError, ValueError)
"""Exceptions of zipfile for damaged, encrypted or exotic archives."""


@dataclass(frozen=True)
class Member:
    """One file in an archive. Holds no open file: archives are kept open, a few at a time, per process."""

    archive: Path
    name: str
    limit: int
    """Bytes that it may unpack to."""

    def read(self) -> bytes:
        """The unpacked content.

        Raises:
            CaptureError: absent, damaged, or larger than the limit.
        """
        try:
            archive = open_archive(self.archive)
            size = archive.getinfo(self.name).file_size
            if size > self.limit:
                raise self._too_large(f"{size} bytes")
            with archive.open(self.name) as file:
                # The size in the directory may be a lie: what is read counts.
                data = file.read(self.limit + 1)
        except KeyError as error:
            raise CaptureError(f"{self.name} is not in the archive", file=self.archive) from error
        except DAMAGE as error:
            raise CaptureError(f"{self.name} is damaged in the archive", file=self.archive, found=str(error)) from error
        if len(data) > self.limit:
            raise self._too_large("more")
        return data

    def _too_large(self, found: str) -> CaptureError:
        return CaptureError(
            f"{self.name} is too large", file=self.archive, expected=f"at most {self.limit} bytes", found=found
        )


def names(path: Path) -> list[str]:
    """Names of all members.

    Raises:
        CaptureError: not a zip archive, too many members, or a name that leads out of a folder.
    """
    try:
        found = open_archive(path).namelist()
    except DAMAGE as error:
        raise CaptureError("not a zip archive, or cut off", file=path, found=str(error)) from error
    if len(found) > MAX_MEMBERS:
        raise CaptureError("too many files in the archive", file=path, expected=f"at most {MAX_MEMBERS}")
    for name in found:
        # Nothing is written to disk here, but an archive with such names was not made by an app.
        if name.startswith(("/", "\\")) or ".." in PurePosixPath(name.replace("\\", "/")).parts:
            raise CaptureError("a name in the archive leads out of its folder", file=path, found=name)
    return found


def open_archive(path: Path) -> zipfile.ZipFile:
    """The archive, opened once for all of its members; zipfile itself locks what two threads share."""
    check_size(path, MAX_ARCHIVE_BYTES)
    return _open(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _open(path: Path, changed: int) -> zipfile.ZipFile:
    return zipfile.ZipFile(path)
