"""Reading with limits, writing whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from realsim.errors import RealsimError

MAX_TEXT_BYTES = 64 * 2**20
MAX_BINARY_BYTES = 2 * 2**30
MARKS = ("report.json", "contact.json", "diagnosis.json", "proposal.json", "truth/truth.json")
"""Files of which every output folder holds one: a scene, a contact, a diagnosis, a case, a synthetic capture."""
_DAMAGED = (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)
"""What reading a damaged, encrypted or exotic archive of arrays raises."""


def check_size(path: Path, limit: int = MAX_BINARY_BYTES) -> None:
    """Refuse a file that is missing, not a plain file, not ours to read, or larger than `limit` bytes."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise RealsimError("the file cannot be read", file=path, found=error.strerror or str(error)) from error
    if not path.is_file():
        raise RealsimError("not a plain file", file=path)
    if not os.access(path, os.R_OK):
        raise RealsimError("the file cannot be read", file=path, found=os.strerror(errno.EACCES))
    if size > limit:
        raise RealsimError("the file is too large", file=path, expected=f"at most {limit} bytes", found=f"{size} bytes")


def read_bytes(path: Path, limit: int = MAX_BINARY_BYTES) -> bytes:
    """The content of a file of at most `limit` bytes."""
    check_size(path, limit)
    try:
        return path.read_bytes()
    except OSError as error:
        raise RealsimError("the file cannot be read", file=path, found=error.strerror or str(error)) from error


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """The UTF-8 text of a file of at most `limit` bytes."""
    try:
        return read_bytes(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RealsimError("not a text file", file=path, expected="UTF-8 text", found=str(error)) from error


def read_json(path: Path) -> Any:
    """Parsed JSON; the error of a broken file names line and column."""
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise RealsimError(
            "broken JSON",
            file=path,
            expected="valid JSON",
            found=f"{error.msg} at line {error.lineno} column {error.colno}",
        ) from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, brackets in brackets without end
        raise RealsimError("broken JSON", file=path, expected="JSON of a usual kind", found=str(error)) from error


def read_npz(path: Path, limit: int = MAX_BINARY_BYTES) -> dict[str, np.ndarray]:
    """The arrays of an .npz file, none of them pickled; at most `limit` bytes, packed and unpacked."""
    check_size(path, limit)
    try:
        # A few kilobytes can unpack to any size: what they say of it is asked first, and nothing beyond is read.
        with zipfile.ZipFile(path) as archive:
            size = sum(item.file_size for item in archive.infolist())
        if size > limit:
            raise RealsimError(
                "the file is too large", file=path, expected=f"at most {limit} bytes unpacked", found=f"{size} bytes"
            )
        with np.load(path, allow_pickle=False) as store:
            return {name: store[name] for name in store.files}
    except (*_DAMAGED, MemoryError) as error:
        raise RealsimError(
            "not a readable .npz of plain numbers", file=path, found=str(error) or type(error).__name__
        ) from error


def to_json(value: Any) -> str:
    """Stable JSON text: sorted nothing, numpy turned into plain numbers, NaN and infinity into null."""
    return json.dumps(_plain(value), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all (temporary name, then rename)."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all (temporary name in the same folder, then rename)."""
    with explain_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            os.chmod(name, 0o644)
            os.replace(name, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise


@contextlib.contextmanager
def explain_write_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's write errors (disk full, no permission) into a message with the way out."""
    hints = {
        errno.ENOSPC: "free some space, or choose another --out",
        errno.EDQUOT: "the quota is used up: choose another --out",
        errno.EACCES: "choose a folder that you may write to",
        errno.EROFS: "the file system is read-only: choose another --out",
    }
    try:
        yield
    except OSError as error:
        raise RealsimError(
            "cannot write", file=path, found=error.strerror or str(error), hint=hints.get(error.errno or 0)
        ) from error


@contextlib.contextmanager
def output_folder(path: Path, *, overwrite: bool = False, source: Path | None = None) -> Iterator[Path]:
    """A folder that appears under its name only when everything in it has been written.

    Yields a temporary sibling; on success it is renamed to `path`, on any error or interrupt it is removed.
    An existing non-empty `path` is refused unless `overwrite`, and then replaced only at the very end.

    Args:
        source: what the folder is made from; it must not go with what is replaced.

    Raises:
        RealsimError: a file, `source` in it, or a folder that is not to be, or not ours to be, replaced.
    """
    path = path.absolute()
    if path.is_file():
        raise RealsimError("the output is a file", file=path, expected="a folder that does not exist yet")
    if source is not None:
        refuse_within(path, source)
    if path.is_dir() and any(path.iterdir()):
        _refuse_existing(path, overwrite)
    with explain_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.partial-"))
    try:
        yield work
        with explain_write_errors(path):
            os.chmod(work, 0o755)
            _replace_folder(work, path)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise


def refuse_within(out: Path, source: Path) -> None:
    """Refuse an output folder that is the input or holds it: what is in it is replaced as a whole."""
    if source.resolve().is_relative_to(out.resolve()):
        raise RealsimError(
            "the input lies in the output folder, which is written as a whole",
            file=source,
            expected="an output folder that does not hold the input",
            found=str(out),
            hint="choose another --out",
        )


def _refuse_existing(path: Path, overwrite: bool) -> None:
    """Refuse to replace a folder that is not empty, unless that was asked for and the folder is ours."""
    if not overwrite:
        raise RealsimError(
            "the output folder exists and is not empty", file=path, hint="choose another --out, or pass --overwrite"
        )
    if not any((path / mark).is_file() for mark in MARKS):
        names = sorted(p.name for p in path.iterdir())
        raise RealsimError(
            "the output folder holds what realsim did not write",
            file=path,
            expected=f"one that realsim wrote (with {', '.join(MARKS[:-1])} or {MARKS[-1]}), or an empty one",
            found=", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else ""),
            hint="choose another --out, or remove the folder yourself",
        )


def _replace_folder(new: Path, target: Path) -> None:
    if not target.exists():
        os.replace(new, target)
        return
    old = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}.old-"))
    os.replace(target, old / target.name)
    os.replace(new, target)
    shutil.rmtree(old, ignore_errors=True)


def inside(root: Path, name: str) -> Path:
    """`root / name`, refused if `name` leads out of `root` (for names read from manifests and archives)."""
    target = (root / name).resolve()
    if not target.is_relative_to(root.resolve()):
        raise RealsimError(
            "a name leads out of its folder", file=root, found=name, expected="a relative path inside it"
        )
    return target


def digest(*parts: Any) -> str:
    """SHA-256 (hex) of byte strings, texts, paths' contents, arrays and plain values."""
    h = hashlib.sha256()
    for part in parts:
        if isinstance(part, Path):
            with part.open("rb") as file:
                h.update(hashlib.file_digest(file, "sha256").digest())
        elif isinstance(part, bytes):
            h.update(part)
        elif isinstance(part, np.ndarray):
            h.update(f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        else:
            h.update(repr(part).encode())
        h.update(b"\0")
    return h.hexdigest()
