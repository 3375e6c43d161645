"""Parquet: a column of numbers, or of lists of numbers, for each signal."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import extra
from realsim.core.text_table import MAX_WIDTH
from realsim.core.types import F64
from realsim.gap.recordings.recording import Reader, Recording, has_suffix, no_samples, readable, refuse_more
from realsim.gap.recordings.tables import rows, table
from realsim.gap.recordings.vocabulary import TIMES


def read(path: Path) -> list[Recording]:
    columns, skipped = columns_of(path)
    if not columns:
        raise no_samples(path, "columns of numbers or of lists of numbers", skipped)
    stream = table(path, "", columns)
    return [Recording(path, path.stem, "parquet", (stream,), skipped)]


def columns_of(path: Path, only: Sequence[str] | None = None) -> tuple[dict[str, F64], dict[str, str]]:
    """(columns of numbers (T,) or (T, K), name -> why another was not read) of a parquet file."""
    parquet = extra("pyarrow.parquet", "logs", "reading parquet")
    found: dict[str, F64] = {}
    skipped: dict[str, str] = {}
    size = 0
    with readable(path, "parquet file"), parquet.ParquetFile(path) as file:
        for name in file.schema_arrow.names:
            if only is not None and name not in only:
                continue
            kind = file.schema_arrow.field(name).type
            if _nested(kind):
                column = file.read(columns=[name]).column(0)
                refuse_more(path, size + column.nbytes // 8)
                found |= rows(path, [{name: value} for value in column.to_pylist()], [])
                continue
            # Pictures (bytes) are never loaded.
            values = _values(file.read(columns=[name]).column(0)) if _numeric(kind) else None
            if values is None:
                skipped[name] = f"{kind}: not numbers"
                continue
            found[name] = values
            size += values.size
            refuse_more(path, size)
    return found, skipped


def _numeric(kind: Any) -> bool:
    import pyarrow.types as t

    if t.is_list(kind) or t.is_large_list(kind) or t.is_fixed_size_list(kind):
        return _numeric(kind.value_type)
    return bool(t.is_integer(kind) or t.is_floating(kind) or t.is_boolean(kind) or t.is_timestamp(kind))


def _nested(kind: Any) -> bool:
    """Whether a column holds structures, or lists of them, of nothing but numbers and words."""
    import pyarrow.types as t

    if t.is_list(kind) or t.is_large_list(kind):
        return _nested(kind.value_type)
    inner = [kind.field(k).type for k in range(kind.num_fields)] if t.is_struct(kind) else []
    return bool(inner) and all(_numeric(i) or t.is_string(i) or _nested(i) for i in inner)


def _values(column: Any) -> F64 | None:
    import pyarrow as pa
    import pyarrow.types as t

    column = column.combine_chunks() if hasattr(column, "combine_chunks") else column
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
    if t.is_timestamp(column.type):
        return TIMES[column.type.unit] * column.cast(pa.int64()).to_numpy(zero_copy_only=False).astype(np.float64)
    if not (t.is_list(column.type) or t.is_large_list(column.type) or t.is_fixed_size_list(column.type)):
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)
    flat = column.flatten()
    if t.is_list(flat.type) or t.is_fixed_size_list(flat.type) or column.null_count:
        return None
    width, rest = divmod(len(flat), max(len(column), 1))
    lengths = None if t.is_fixed_size_list(column.type) else np.diff(column.offsets.to_numpy())
    if rest or not 0 < width <= MAX_WIDTH or (lengths is not None and (lengths != width).any()):
        return None
    return np.asarray(flat.to_numpy(zero_copy_only=False), dtype=np.float64).reshape(-1, width)


READER = Reader("parquet", "a .parquet file", has_suffix(".parquet", ".pq"), read)
