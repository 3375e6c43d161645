"""Reading with limits, writing whole or not at all."""

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import re
import shutil
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from glob import escape as glob_escape
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import RealsimError

MAX_TEXT_BYTES = 64 * 2**20
MAX_BINARY_BYTES = 2 * 2**30
MAX_YAML_VALUES = 10**6
"""More than any camera, policy or list of topics has."""
MAX_DIGITS = 300
"""Of a whole number in JSON: a longer one has no value as a floating-point number, which end at 1.8e308."""
MARKS = (
    "report.json",
    "contact.json",
    "diagnosis.json",
    "proposal.json",
    "truth/truth.json",
    "export.json",
    "experiment.json",
)
"""Files of which every output folder holds one: a scene, `realsim contact`, a diagnosis, a case, a synthetic
capture, an export, an experiment."""
_DAMAGED = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    RuntimeError,
    SyntaxError,
    zipfile.BadZipFile,
    zlib.error,
    tokenize.TokenError,
)
"""Exceptions of reading a damaged, encrypted or exotic archive of arrays."""


def check_size(path: Path, limit: int = MAX_BINARY_BYTES) -> None:
    """Refuse a file that is missing, not a plain file, not ours to read, or larger than `limit` bytes."""
    try:
        size = path.stat().st_size
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        found = getattr(error, "strerror", None) or str(error)
        raise _unreadable(path, found) from error
    # What the system makes up while it is read (a link to /proc/kmsg) may never end.
    made_up = (size == 0 and path.resolve().is_relative_to("/proc")) or path.resolve().is_relative_to("/sys")
    if not path.is_file() or made_up:
        raise RealsimError("not a plain file", file=path, expected="a file, not a folder, pipe or device")
    if not os.access(path, os.R_OK):
        raise _unreadable(path, os.strerror(errno.EACCES))
    if size > limit:
        raise RealsimError("the file is too large", file=path, expected=f"at most {limit} bytes", found=f"{size} bytes")


def _unreadable(path: Path, found: str) -> RealsimError:
    hint = "check the path, and that you may read it"
    return RealsimError("the file cannot be read", file=path, expected="a file", found=found, hint=hint)


def read_bytes(path: Path, limit: int = MAX_BINARY_BYTES) -> bytes:
    """The content of a file of at most `limit` bytes."""
    check_size(path, limit)
    try:
        return path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error.strerror or str(error)) from error


def read_head(path: Path, count: int, offset: int = 0) -> bytes:
    """At most `count` bytes of a file, from `offset` on."""
    check_size(path)
    try:
        with path.open("rb") as file:
            file.seek(offset)
            return file.read(count)
    except OSError as error:
        raise _unreadable(path, error.strerror or str(error)) from error


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """The UTF-8 text of a file of at most `limit` bytes."""
    try:
        return read_bytes(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RealsimError("not a text file", file=path, expected="UTF-8 text", found=str(error)) from error


def read_json(path: Path) -> Any:
    """Parsed JSON; the error of a broken file names line and column."""
    return parse_json(read_text(path), path)


def parse_json(text: str | bytes, path: Path) -> Any:
    """Parsed JSON; `path` is where it is from, for the error."""
    try:
        return json.loads(text, parse_int=_whole, parse_float=_real, object_pairs_hook=_object)
    except (ValueError, RecursionError) as error:  # also a number of thousands of digits, brackets without end
        raise RealsimError("broken JSON", file=path, expected="valid JSON", found=str(error)) from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object; a name with two different values is refused, as nothing says which of them is meant."""
    value = dict(pairs)
    for name, item in pairs if len(value) < len(pairs) else []:
        if value[name] != item:
            raise ValueError(f"the name {name[:80]!r} twice in one object, with different values")
    return value


def _whole(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def _real(digits: str) -> float:
    value = float(digits)
    if value in (float("inf"), -float("inf")):
        raise ValueError(f"a number beyond 1.8e308: {digits[:30]}")
    return value


def parse_yaml(text: str, path: Path) -> Any:
    """Parsed plain YAML; `path` is where it is from, for the error. Aliases of aliases, a few lines of which stand for
    billions of values, are refused before anything walks them."""
    import yaml

    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        count = _expanded(node, {})
        if count <= MAX_YAML_VALUES:
            return None if node is None else loader.construct_document(node)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise RealsimError(
            "broken YAML", file=path, expected="valid YAML", found=" ".join(str(error).split())
        ) from error
    raise RealsimError(
        "YAML whose aliases expand without end",
        file=path,
        expected=f"at most {MAX_YAML_VALUES} values",
        found=f"{count:.2g} in {len(text)} characters",
        hint="write the values out, without & and *",
    )


def _expanded(node: Any, known: dict[int, int]) -> int:
    """Values below a node of YAML, aliases counted each time; `known` has those of nodes that were counted before.

    Raises:
        ValueError: a name that one mapping has twice.
    """
    if id(node) not in known:
        known[id(node)] = MAX_YAML_VALUES + 1  # of a node within itself
        entries = node.value if isinstance(getattr(node, "value", None), list) else []
        children = [c for entry in entries for c in (entry if isinstance(entry, tuple) else (entry,))]
        names = set()
        for name in (entry[0] for entry in entries if isinstance(entry, tuple)):
            if (name.tag, str(name.value)) in names:  # the parser would take the last value without a word
                raise ValueError(f"the name {name.value!r} twice, again in line {name.start_mark.line + 1}")
            names.add((name.tag, str(name.value)))
        known[id(node)] = 1 + sum(_expanded(child, known) for child in children)
    return known[id(node)]


def read_npz(path: Path, limit: int = MAX_BINARY_BYTES) -> dict[str, np.ndarray]:
    """The arrays of an .npz file, none of them pickled; at most `limit` bytes, packed and unpacked.

    Members that are no arrays are left out, as nothing asks for them.
    """
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
            found = {name: store[name] for name in store.files}
        # Of a member that is no array, numpy gives the bytes.
        return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}
    except (*_DAMAGED, MemoryError) as error:
        raise RealsimError(
            "not a readable .npz", file=path, expected="plain numbers", found=str(error) or type(error).__name__
        ) from error


def archive_damage(path: Path) -> str | None:
    """What is wrong with a zip archive: the first member that does not read back as it was written, or its directory.

    None if every member is right, or if the file does not begin as an archive does. torch reads arrays without looking
    at the checksums that it wrote with them: a flipped bit is another number. What cannot be checked is damage too, as
    torch may read it all the same.
    """
    if read_head(path, 4) != b"PK\x03\x04":
        return None
    name = "the list of members"
    try:
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                with archive.open(name) as member:
                    while member.read(2**20):
                        pass
    except _DAMAGED as error:
        return f"{name}: {str(error) or type(error).__name__}"
    return None


def to_json(value: Any) -> str:
    """Stable JSON text: sorted nothing, numpy turned into plain numbers, NaN and infinity into null."""
    text = json.dumps(_plain(value), indent=1, allow_nan=False, ensure_ascii=False)
    # json escapes the control characters below 32 only; those from 127 to 159 control terminals as well, and what
    # stands for a byte of a file name that is no text (a lone surrogate) cannot be written as text.
    return re.sub(r"[\x7f-\x9f\ud800-\udfff]", lambda c: f"\\u{ord(c[0]):04x}", text) + "\n"


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
    """Write a text file whole or not at all (temporary name, then rename).

    What stands for a byte of a file name that is no text is written as an escape.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_files(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write every file whole or not at all, by its name; their paths."""
    for name, data in files.items():
        write_bytes(folder / name, data)
    return [folder / name for name in files]


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
        errno.ENAMETOOLONG: "choose a shorter --out",
    }
    try:
        yield
    except OSError as error:
        raise RealsimError(
            "cannot write", file=path, found=error.strerror or str(error), hint=hints.get(error.errno or 0)
        ) from error


@contextlib.contextmanager
def output_folder(
    path: Path, *, overwrite: bool = False, source: Path | None = None, marks: Sequence[str] = MARKS
) -> Iterator[Path]:
    """A folder that appears under its name only when everything in it has been written.

    Yields a temporary sibling; on success it is renamed to `path`, on any error or interrupt it is removed.
    An existing non-empty `path` is refused unless `overwrite`, and then replaced only at the very end.

    Args:
        source: what the folder is made from; it must not go with what is replaced.
        marks: files of which a folder that may be replaced holds one.

    Raises:
        RealsimError: a file, `source` in it, or a folder that is not to be, or not ours to be, replaced.
    """
    path = path.absolute()
    for place in (path, *path.parents):
        if os.path.isfile(place):  # also of a name that is too long, or a link in a circle
            raise RealsimError("the output is a file", file=place, expected="a folder", hint="choose another --out")
    if source is not None:
        refuse_within(path, source)
    refuse_existing(path, overwrite, marks)
    made = [parent for parent in path.parents if not os.path.exists(parent)]
    with explain_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        _sweep(path)
        new = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.new-"))
        # It is locked before it has the name by which unfinished folders are found: whoever can lock one may remove it.
        work = new.with_name(f".{path.name}.partial-{new.name.removeprefix(f'.{path.name}.new-')}")
    try:
        with _held(new):
            new.rename(work)
            yield work
            with explain_write_errors(path):
                os.chmod(work, 0o755)
                place_folder(work, path, overwrite=overwrite, marks=marks)
    except BaseException:
        shutil.rmtree(work if work.exists() else new, ignore_errors=True)
        for parent in made:
            with contextlib.suppress(OSError):  # not empty: somebody else writes there too
                parent.rmdir()
        raise


@contextlib.contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Lock a folder as long as this process works on it; the system lets go of it however the process ends."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks: nothing is swept there
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def _sweep(path: Path) -> None:
    """Remove what killed runs left beside `path`: unfinished folders that no process holds, and replaced ones whose
    successor is in place."""
    left = list(path.parent.glob(f".{glob_escape(path.name)}.partial-*"))
    left += list(path.parent.glob(f".{glob_escape(path.name)}.old-*")) if path.is_dir() else []
    for folder in left:
        with contextlib.suppress(OSError):
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(handle)


def check_room(folder: Path, need: float, message: str) -> None:
    """Refuse a folder, which need not exist, on a disk with less than `need` bytes free.

    Raises:
        RealsimError: with this message.
    """
    there = next(p for p in (folder, *folder.absolute().parents) if p.is_dir())
    if (free := shutil.disk_usage(there).free) < need:
        raise RealsimError(
            message, file=folder, expected=f"{need / 1e6:.0f} MB free", found=f"{free / 1e6:.0f} MB",
            hint="free some space, or choose another folder",
        )  # fmt: skip


def refuse_within(out: Path, source: Path) -> None:
    """Refuse an output folder that is the input or holds it: what is in it is replaced as a whole."""
    if Path(os.path.realpath(source)).is_relative_to(os.path.realpath(out)):
        raise RealsimError(
            "the input lies in the output folder, which is replaced as a whole",
            file=source,
            expected="an output folder that does not hold the input",
            found=str(out),
            hint="choose another --out",
        )


def place_folder(work: Path, target: Path, *, overwrite: bool = False, marks: Sequence[str] = MARKS) -> None:
    """Give a finished folder its name, in one step that cannot hide or remove what anybody else put there meanwhile.

    Args:
        work: the folder, on the same file system as `target`.
        overwrite: whether a folder there that holds one of `marks` may be replaced.

    Raises:
        RealsimError: `target` is not empty, and not to be or not ours to be replaced. `work` is as it was.
    """
    for _ in range(10):  # another process may put a folder there between two steps
        try:
            os.rename(work, target)  # replaces an empty folder, and refuses any other
            return
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
        refuse_existing(target, overwrite, marks)
        old = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}.old-"))
        with contextlib.suppress(FileNotFoundError):
            os.rename(target, old / target.name)
        try:
            os.rename(work, target)
        except OSError:
            # Somebody was faster. Theirs stays; what was there before them is gone either way, as for them.
            shutil.rmtree(old, ignore_errors=True)
            continue
        shutil.rmtree(old, ignore_errors=True)
        return
    raise RealsimError("the output folder keeps changing", file=target, hint="choose another --out")


def refuse_existing(path: Path, overwrite: bool, marks: Sequence[str] = MARKS) -> None:
    """Refuse to replace a folder that is not empty, unless that was requested and the folder is ours."""
    if not os.path.isdir(path) or not any(path.iterdir()):
        return
    if not overwrite:
        raise RealsimError(
            "the output folder exists and is not empty", file=path, hint="choose another --out, or pass --overwrite"
        )
    if not any((path / mark).is_file() for mark in marks):
        names = sorted(p.name for p in path.iterdir())
        raise RealsimError(
            "the output folder holds files that realsim did not write",
            file=path,
            expected=f"one that realsim wrote (with {' or '.join(marks)}), or an empty one",
            found=", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else ""),
            hint="choose another --out, or remove the folder yourself",
        )


def refuse_file(path: Path, overwrite: bool) -> None:
    """Refuse to replace a file, unless that was requested; to be called before the work that makes it."""
    if path.is_dir():
        raise RealsimError("the output is a folder", file=path, expected="a file that does not exist yet")
    if path.exists() and not overwrite:
        raise RealsimError("the output file exists", file=path, hint="choose another --out, or pass --overwrite")


def inside(root: Path, name: str) -> Path:
    """`root / name`, refused if `name` leads out of `root` (for names read from manifests and archives)."""
    try:
        target, base = (root / name).resolve(), root.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, a zero byte in the name
        raise RealsimError(
            "a name cannot be followed", file=root, expected="a plain file or a link to one", found=f"{name}: {error}"
        ) from error
    if not target.is_relative_to(base):
        raise RealsimError(
            "a path leads out of its folder",
            file=root,
            found=name if str(target) == os.path.normpath(base / name) else f"{name}, a link to {target}",
            expected="a relative path inside it",
            hint="put what it names into the folder, instead of a path or a link to it",
        )
    return target


def file_digests(folder: Path, *, without: Sequence[str] = ()) -> dict[str, str]:
    """Path below a folder -> SHA-256 of every file in it, in order; not of those `without`, paths below it."""
    paths = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    return {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in paths.items() if name not in without}


def edited_files(folder: Path, digests: Any) -> tuple[str, ...]:
    """Of `file_digests`, as a report has kept them: the files that have other content now, or are gone.

    Files that came later are no concern of the report. What is no such map (a report of an older version) knows none.
    """
    known = digests if isinstance(digests, Mapping) else {}
    found = []
    for name, value in known.items():
        path = inside(folder, name)
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != value:
            found.append(str(name))
    return tuple(found)


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
