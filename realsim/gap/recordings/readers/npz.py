"""NumPy archives: an array a signal, its rows the samples; or one table `data` with its columns' names in `cols`."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import read_npz
from realsim.core.types import F64
from realsim.gap.recordings.recording import (
    Reader,
    Recording,
    Stream,
    Window,
    has_suffix,
    no_samples,
    refuse_more,
)
from realsim.gap.recordings.tables import as_long_as_most, table

NAMES = ("cols", "columns", "names", "header")


def read(path: Path, window: Window) -> list[Recording]:
    arrays = read_npz(path)
    texts = {n: v for n, v in arrays.items() if v.dtype.kind in "US"}
    numbers = {n: np.asarray(v, dtype=np.float64) for n, v in arrays.items() if v.dtype.kind in "fiub"}
    facts: dict[str, Any] = {n: v.item() for n, v in numbers.items() if v.size == 1}
    for name, text in texts.items():
        if text.ndim == 0:
            facts |= _said(name, str(text))
    columns = _table(numbers, texts) or as_long_as_most(numbers)
    if not columns:
        raise no_samples(path, "arrays with a row a sample", {n: str(v.shape) for n, v in arrays.items()})
    refuse_more(path, sum(v.size for v in columns.values()))
    stream = table(path, "", columns, window=window)
    labels = next((tuple(map(str, v)) for v in texts.values() if v.ndim == 1 and len(v) > 1), ())
    fields = {
        n: replace(f, labels=labels) if not f.labels and f.width == len(labels) else f for n, f in stream.fields.items()
    }
    return [Recording(path, path.stem, "npz", (Stream(stream.name, "table", stream.clocks, fields),), facts=facts)]


def _table(numbers: dict[str, F64], texts: dict[str, Any]) -> dict[str, F64]:
    """One array of all columns, beside the list of their names."""
    for name in NAMES:
        header = texts.get(name)
        if header is None or header.ndim != 1:
            continue
        for values in numbers.values():
            if values.ndim == 2 and values.shape[1] == len(header):
                return {str(h): values[:, i] for i, h in enumerate(header)}
    return {}


def _said(name: str, text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return {name: text[:200]}
    return value if isinstance(value, dict) else {name: value}


READER = Reader("npz", "a .npz file", has_suffix(".npz"), read)
