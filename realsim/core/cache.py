"""Finished stages, kept and reused while their inputs have not changed.

A key is the digest of everything a result depends on: the content of the capture's files and how they are read, the
configuration, the source code that computes it, and the versions of the packages that it calls. Values are dataclasses
of `realsim.core.types` made of plain values and arrays, stored as one .npz without pickles. The oldest entries go when
the folder grows beyond its limit.
"""

import contextlib
import dataclasses
import io
import json
import os
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from realsim.core import types
from realsim.core.errors import RealsimError
from realsim.core.files import digest, write_bytes
from realsim.core.progress import note

T = TypeVar("T")
MAX_BYTES = 4 * 2**30
COMPUTING = (
    "numpy",
    "scipy",
    "open3d",
    "opencv-contrib-python-headless",
    "scikit-image",
    "trimesh",
    "fast-simplification",
    "manifold3d",
    "pymeshlab",
    "onnxruntime",
    "pycolmap",
    "mujoco",
    "coacd",
    "OpenEXR",
    "lzfse",
)
"""Packages that stages whose results are kept compute with: another version may give another result."""


def default_folder() -> Path:
    """`REALSIM_CACHE`, else the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(os.environ.get("REALSIM_CACHE") or Path(base) / "realsim")


class StageCache:
    """Results by key in a folder; `folder=None` keeps nothing."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    def get_or_make(self, key: str, make: Callable[[], T]) -> tuple[T, bool]:
        """(result, whether it was reused). A broken or foreign entry is reported and made again."""
        if self.folder is None:
            return make(), False
        path = self.folder / f"{key}.npz"
        if path.is_file():
            try:
                value = unpack(path.read_bytes())
            except Exception as error:  # damage shows as anything from zlib.error to NotImplementedError
                note(f"the kept result {path} cannot be read and is made again ({type(error).__name__}: {error})")
            else:
                with contextlib.suppress(OSError):  # a read-only cache is as good; its entries only look older
                    os.utime(path)
                return value, True
        value = make()
        # A full or read-only disk must not spoil a result that is already there.
        with contextlib.suppress(RealsimError, OSError):
            write_bytes(path, pack(value))
            self._trim()
        return value, False

    def _trim(self) -> None:
        assert self.folder is not None
        entries = sorted(((p.stat().st_mtime, p.stat().st_size, p) for p in self.folder.glob("*.npz")), reverse=True)
        total = 0
        for _, size, path in entries:
            total += size
            if total > MAX_BYTES:
                path.unlink(missing_ok=True)


@cache
def code_digest(*packages: str) -> str:
    """Digest of the source of `realsim` subpackages, of the modules that they all share, and of what they call."""
    root = Path(__file__).parents[1]
    files = sorted(root.glob("*.py")) + [f for p in ("core", *packages) for f in sorted((root / p).rglob("*.py"))]
    return digest(*files, [f"{name} {_version(name)}" for name in COMPUTING])


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def source_digest(source: types.FrameSet | types.Scan) -> str:
    """Digest of a capture: what its files hold, and how they were read."""
    if isinstance(source, types.Scan):
        return digest(
            source.points, source.triangles, source.normals, source.colors, source.sensor_position, source.up_world
        )
    parts: list[Any] = [source.layout, source.poses_metric, source.up_world]
    named: set[Path] = set()
    for frame in source.frames:
        readers = (frame.read_depth, frame.read_color, frame.read_confidence)
        # Many frames may be read from one video or archive: its content is looked at once.
        files = dict.fromkeys([*frame.files, *(path for reader in readers for path in _files_of(reader))])
        parts += [frame.name, frame.intrinsics, frame.color_intrinsics, frame.T_world_camera]
        parts += [_made_of(readers), *(path for path in files if path not in named)]
        named.update(files)
    return digest(*parts)


def _made_of(reader: Any) -> Any:
    """The kind of a frame's reader and what it was told (the depth's unit, limits, a video frame's number).

    Without paths and addresses: a capture in another folder, or in another process, is the same capture.
    """
    if isinstance(reader, (tuple, list)):
        return tuple(map(_made_of, reader))
    if isinstance(reader, np.ndarray):
        return reader.tolist()
    if _is_record(reader):
        values = (getattr(reader, f.name) for f in dataclasses.fields(reader))
        return (type(reader).__qualname__, *map(_made_of, values))
    if reader is None or isinstance(reader, (bool, int, float, str)):
        return reader
    return getattr(reader, "__qualname__", type(reader).__qualname__)


def _files_of(reader: Any) -> Iterator[Path]:
    """Files that a reader of a frame holds."""
    if isinstance(reader, Path) and reader.is_file():
        yield reader
    elif _is_record(reader):
        for f in dataclasses.fields(reader):
            yield from _files_of(getattr(reader, f.name))


def _is_record(value: Any) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def pack(value: Any) -> bytes:
    """Bytes of a tree of dataclasses from `realsim.core.types`, tuples, mappings, arrays and plain values."""
    arrays: list[np.ndarray] = []
    tree = _encode(value, arrays)
    out = io.BytesIO()
    named = {f"a{i}": a for i, a in enumerate(arrays)}
    text = np.frombuffer(json.dumps(tree).encode(), np.uint8)
    np.savez_compressed(out, allow_pickle=False, tree=text, **named)
    return out.getvalue()


def unpack(data: bytes) -> Any:
    """Inverse of `pack`. Anything else raises whatever its reading meets: ValueError, zlib.error, BadZipFile."""
    with np.load(io.BytesIO(data), allow_pickle=False) as store:
        tree = json.loads(store["tree"].tobytes())
        return _decode(tree, store)


def _encode(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("object arrays cannot be stored")
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, np.generic):
        return value.item()
    if _is_record(value):
        fields = {f.name: _encode(getattr(value, f.name), arrays) for f in dataclasses.fields(value)}
        return {"type": type(value).__name__, "fields": fields}
    if isinstance(value, Mapping):
        return {"map": [[str(k), _encode(v, arrays)] for k, v in value.items()]}
    if isinstance(value, tuple):
        return {"tuple": [_encode(v, arrays) for v in value]}
    if isinstance(value, list):
        return [_encode(v, arrays) for v in value]
    if isinstance(value, Path):
        return {"path": str(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"{type(value).__name__} cannot be stored")


def _decode(tree: Any, store: Mapping[str, np.ndarray]) -> Any:
    if isinstance(tree, list):
        return [_decode(v, store) for v in tree]
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return store[f"a{tree['array']}"]
    if "tuple" in tree:
        return tuple(_decode(v, store) for v in tree["tuple"])
    if "map" in tree:
        return {k: _decode(v, store) for k, v in tree["map"]}
    if "path" in tree:
        return Path(tree["path"])
    kind = getattr(types, tree["type"], None)
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        raise ValueError(f"unknown type {tree['type']!r}")
    return kind(**{k: _decode(v, store) for k, v in tree["fields"].items()})
