"""MATLAB's .mat files: arrays and structures of arrays, Simulink's `structure with time` among them.

Objects of classes (`timeseries`, `Dataset`) cannot be read without MATLAB. From version 7.3 on, the file is HDF5.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import MAX_BINARY_BYTES, check_size
from realsim.gap.recordings.flatten import flatten
from realsim.gap.recordings.readers import hdf5
from realsim.gap.recordings.recording import Reader, Recording, facts_of, has_suffix, readable
from realsim.gap.recordings.tables import as_long_as_most, table

COMPRESSED = 15
"""Type of an element that is packed by zlib (MATLAB, MAT-File Format, table 1-1)."""
CHUNK = 2**24
HDF5 = b"\x89HDF\r\n\x1a\n"


def read(path: Path) -> list[Recording]:
    from scipy.io import loadmat

    check_size(path)
    with path.open("rb") as file:
        head = file.read(512 + len(HDF5))
    if HDF5 in (head[: len(HDF5)], head[512:]):
        return hdf5.read(path)
    with readable(path, ".mat file", "arrays, or structures of arrays, saved by MATLAB or scipy"):
        _refuse_bomb(path, ">" if head[126:128] == b"MI" else "<")
        value = loadmat(path, simplify_cells=True)
    value = {n: v for n, v in value.items() if not n.startswith("__")}
    arrays = {n: v for n, v in flatten(value).items() if isinstance(v, np.ndarray)}
    found = {n: v.astype(np.float64) for n, v in arrays.items() if v.dtype.kind in "fiub" and v.ndim in (1, 2)}
    columns = as_long_as_most(found)
    if not columns:
        hint = "objects such as timeseries need MATLAB: t = ts.Time; q = ts.Data; save('log.mat', 't', 'q')"
        shapes = "; ".join(f"{n} {v.shape}" for n, v in list(found.items())[:12]) or "nothing"
        raise GapError("no arrays with a row a sample", file=path, found=shapes, hint=hint)
    return [Recording(path, path.stem, "matlab", (table(path, "", columns),), facts=facts_of(value))]


def _refuse_bomb(path: Path, order: str) -> None:
    """Stop where compressed parts of a file of version 5 to 7 hold more than may be read."""
    size = 0
    with path.open("rb") as file:
        file.seek(128)
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            if kind != COMPRESSED:
                file.seek(length, 1)
                continue
            unpacker, packed = zlib.decompressobj(), file.read(length)
            while packed and not unpacker.eof:
                size += len(unpacker.decompress(packed, CHUNK))
                packed = unpacker.unconsumed_tail
                if size > MAX_BINARY_BYTES:
                    raise GapError(
                        "the file unpacks to too much", file=path, expected=f"at most {MAX_BINARY_BYTES} bytes"
                    )


READER = Reader("matlab", "a .mat file", has_suffix(".mat"), read)
