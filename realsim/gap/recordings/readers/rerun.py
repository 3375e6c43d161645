"""Rerun's .rrd: every component of numbers of every entity, on the timeline that its program stamped.

`log_time`, when a message reached the library, is the clock only where there is no other: data that are converted later
have the time of the conversion there.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import extra
from realsim.core.text_table import MAX_WIDTH
from realsim.core.types import F64
from realsim.gap.recordings.recording import (
    Field,
    Reader,
    Recording,
    Stream,
    has_suffix,
    no_samples,
    readable,
    refuse_more,
)
from realsim.gap.recordings.tables import grouped
from realsim.gap.recordings.vocabulary import unit_of

RECEIVED = "log_time"


def read(path: Path) -> list[Recording]:
    chunks = extra("rerun.chunk", "rerun", "reading .rrd")
    parts: dict[tuple[str, str], list[tuple[F64, F64]]] = {}
    labels: dict[str, tuple[str, ...]] = {}
    skipped: dict[str, str] = {}
    size = 0
    with readable(path, ".rrd file"):
        file = chunks.RrdReader(str(path))
        count = len(file.recordings())
        for chunk in file.stream() if count else ():
            entity = chunk.entity_path.strip("/")
            batch = chunk.to_record_batch()
            if chunk.is_static:
                labels[entity] = _names(batch) or labels.get(entity, ())
                continue
            for member, clock, time, values in _components(entity, batch, skipped):
                parts.setdefault((member, clock), []).append((time, values))
                size += values.size
                refuse_more(path, size)
    streams = _streams(parts, labels, skipped)
    if not streams:
        raise no_samples(path, "components of numbers on a timeline", skipped)
    notes = (f"{count} recordings are in the file: the first is read",) if count > 1 else ()
    return [Recording(path, path.stem, "rerun", streams, skipped, notes)]


def _components(entity: str, batch: Any, skipped: dict[str, str]) -> Iterator[tuple[str, str, F64, F64]]:
    """(name, clock, (T,) s, (T, K) values) of each component of numbers in a chunk."""
    clock, time = _time(batch)
    for name in _of_kind(batch, b"data"):
        short = name.rpartition(":")[2]
        member = entity if name == "Scalars:scalars" else f"{entity}.{short}"
        rows = _rows(batch.column(name))
        width = max((len(r) for r in rows if r is not None), default=0)
        keep = [i for i, r in enumerate(rows) if r is not None and len(r) == width]
        if clock and keep and 0 < width <= MAX_WIDTH:
            yield member, clock, time[keep], np.array([rows[i] for i in keep], dtype=np.float64)
        elif not member.startswith("__"):
            skipped[member] = "on no timeline of time" if rows and not clock else "not a row of numbers"


def _time(batch: Any) -> tuple[str, F64]:
    """(timeline, (T,) s): the first that counts time and is not the library's own, else that one."""
    import pyarrow as pa
    import pyarrow.types as t

    names = [n for n in _of_kind(batch, b"index") if not t.is_integer(batch.schema.field(n).type)]
    for name in sorted(names, key=lambda n: (n == RECEIVED, n)):
        return name, 1e-9 * batch.column(name).cast(pa.int64()).to_numpy(zero_copy_only=False).astype(np.float64)
    return "", np.zeros(0)


def _of_kind(batch: Any, kind: bytes) -> list[str]:
    return [f.name for f in batch.schema if (f.metadata or {}).get(b"rerun:kind") == kind]


def _rows(column: Any) -> list[F64 | None]:
    """(K,) of each row of lists of numbers or of vectors; none of anything else, nor of clouds and pictures."""
    import pyarrow.types as t

    flat = column
    while t.is_list(flat.type) or t.is_fixed_size_list(flat.type):
        flat = flat.flatten()
    number = t.is_floating(flat.type) or (t.is_integer(flat.type) and not t.is_uint8(flat.type))
    if not number or len(flat) > MAX_WIDTH * len(column):
        return []
    return [None if row is None else np.ravel(row) for row in column.to_pylist()]


def _names(batch: Any) -> tuple[str, ...]:
    """The names of an entity's lines (SeriesLines, SeriesPoints), if the chunk has them."""
    columns = [n for n in _of_kind(batch, b"data") if n.endswith(":names")]
    return tuple(map(str, batch.column(columns[0])[0].as_py() or ())) if columns else ()


def _streams(
    parts: dict[tuple[str, str], list[tuple[F64, F64]]], labels: dict[str, tuple[str, ...]], skipped: dict[str, str]
) -> tuple[Stream, ...]:
    """Components that were logged at the same moments are one stream."""
    together: dict[tuple[str, bytes], tuple[F64, dict[str, F64]]] = {}
    for (member, clock), found in parts.items():
        widths = [v.shape[1] for _, v in found]
        width = max(set(widths), key=widths.count)
        time = np.concatenate([t for t, v in found if v.shape[1] == width])
        values = np.concatenate([v for _, v in found if v.shape[1] == width])
        order = np.argsort(time, kind="stable")
        if len(order) > 1:
            together.setdefault((clock, time[order].tobytes()), (time[order], {}))[1][member] = values[order]
        else:
            skipped[member] = "hardly a sample"
    streams = []
    for (clock, _), (time, columns) in together.items():
        scalars = {n: v[:, 0] for n, v in columns.items() if v.shape[1] == 1}
        wide = {}
        for n, v in columns.items():
            if v.shape[1] > 1:
                own = labels.get(n, ())
                wide[n] = Field(v, own if len(own) == len(set(own)) == v.shape[1] else (), unit_of(n))
        name = next(iter(columns)) if len(together) > 1 else ""
        key = "receive" if clock == RECEIVED else "header"
        streams.append(Stream(name, "table", {key: time}, wide | grouped(scalars)))
    return tuple(streams)


READER = Reader("rerun", "a Rerun .rrd file", has_suffix(".rrd"), read)
