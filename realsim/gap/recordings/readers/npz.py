"""NumPy archives: an array a signal, its rows the samples; or one table `data` with its columns' names in `cols`."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.files import read_npz
from realsim.core.types import F64
from realsim.gap.recordings.recording import Reader, Recording, facts_of, has_suffix
from realsim.gap.recordings.tables import named, of_arrays

MAX_ROBOTS = 12
"""Robots of one dump that are read, each as a run: those of a simulator are alike, and a search takes few runs."""
NAMES = ("cols", "columns", "names", "header")


def read(path: Path) -> list[Recording]:
    arrays = read_npz(path)
    texts = {n: v for n, v in arrays.items() if v.dtype.kind in "US"}
    numbers = {n: np.asarray(v, dtype=np.float64) for n, v in arrays.items() if v.dtype.kind in "fiub"}
    facts: dict[str, Any] = {n: v.item() for n, v in numbers.items() if v.size == 1}
    facts |= facts_of({n: str(v) for n, v in texts.items() if v.ndim == 0})
    if worlds := _worlds(numbers):
        left = (f"{path.name}: {MAX_ROBOTS} of its {len(worlds)} robots were read",) if len(worlds) > MAX_ROBOTS else ()
        return [
            replace(_recording(path, w, texts, facts), name=f"{path.stem}_{k}", notes=left)
            for k, w in enumerate(worlds[:MAX_ROBOTS])
        ]
    return [_recording(path, numbers, texts, facts)]


def _worlds(numbers: dict[str, F64]) -> list[dict[str, F64]]:
    """Of arrays (T, robots, K), as a vectorised simulator dumps them, those of each robot; nothing of other ones."""
    deep = {n: v for n, v in numbers.items() if v.ndim == 3}
    sides = {v.shape[:2] for v in deep.values()}
    if len(deep) < 2 or len(sides) > 1:
        return []
    ((_, count),) = sides
    flat = {n: v for n, v in numbers.items() if v.ndim < 3}
    return [{n: np.asarray(v[:, k]) for n, v in deep.items()} | flat for k in range(count)]


def _recording(path: Path, numbers: dict[str, F64], texts: dict[str, Any], facts: dict[str, Any]) -> Recording:
    stream = of_arrays(path, _table(numbers, texts) or numbers)
    stream = named(stream, [tuple(map(str, v)) for v in texts.values() if v.ndim == 1])
    return Recording(path, path.stem, "npz", (stream,), facts=facts)


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


READER = Reader("npz", "a .npz file", has_suffix(".npz"), read)
