"""HDF5 (.h5, .hdf5), as robot learning keeps demonstrations, and MATLAB's files since version 7.3, which are HDF5.

A dataset is a signal, its rows the samples. Groups whose names differ by their number alone (`demo_0`, `demo_1`) are
runs. Links and datasets that lead to other files are refused, and links to a group above are not followed.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, extra
from realsim.core.files import check_size
from realsim.core.text_table import MAX_WIDTH
from realsim.core.types import F64
from realsim.gap.recordings.recording import Reader, Recording, facts_of, has_suffix, no_samples, readable, refuse_more
from realsim.gap.recordings.tables import as_long_as_most, named, table

MAX_DATASETS = 10_000
DEEPEST = 12
"""Groups within groups."""


def read(path: Path) -> list[Recording]:
    h5py = extra("h5py", "logs", "reading HDF5")
    check_size(path)
    with readable(path, "HDF5 file", "groups and datasets"), h5py.File(path, "r") as file:
        datasets = {n: d for n, d in _datasets(h5py, file, path, "", ()) if d.dtype.kind in "fiub" or d.dtype.names}
        refuse_more(path, sum(d.size for d in datasets.values()))
        lists = [texts for _, d in _datasets(h5py, file, path, "", ()) if (texts := _texts(h5py, file, d))]
        facts: dict[str, Any] = {n: d[()].item() for n, d in datasets.items() if d.size == 1 and not d.dtype.names}
        file.visititems(lambda _, item: facts.update(facts_of(item.attrs if isinstance(item, h5py.Group) else {})))
        facts |= facts_of(file.attrs)
        runs = _runs(datasets)
        columns = {run: as_long_as_most(_numbers(found)) for run, found in runs.items()}
        shapes = {n: str(d.shape) for n, d in list(datasets.items())[:12]}
    found = [
        Recording(
            path, f"{path.stem}_{run}" if run else path.stem, "hdf5", (named(table(path, "", c), lists),), facts=facts
        )
        for run, c in columns.items()
        if c
    ]
    if not found:
        raise no_samples(path, "datasets with a row a sample", shapes)
    return found


def _datasets(h5py: Any, group: Any, path: Path, place: str, above: tuple[Any, ...]) -> Iterator[tuple[str, Any]]:
    """(name with dots, dataset) of up to two dimensions, beside those of length 1, below a group."""
    if len(above) > DEEPEST or group.id in above:
        return
    for number, name in enumerate(group):
        link, full = group.get(name, getlink=True), f"{place}.{name}".lstrip(".")
        if number > MAX_DATASETS:
            raise GapError("too many datasets", file=path, expected=f"at most {MAX_DATASETS} in a group")
        if isinstance(link, h5py.ExternalLink):
            raise _leads_away(path, full, f"a link to {link.filename}")
        if not isinstance(link, h5py.HardLink) or name.startswith("#"):  # MATLAB keeps what cells refer to below #refs#
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from _datasets(h5py, item, path, full, (*above, group.id))
        elif isinstance(item, h5py.Dataset) and item.shape is not None and sum(n > 1 for n in item.shape) <= 2:
            if item.external or item.is_virtual:
                raise _leads_away(path, full, "a dataset whose values lie in other files")
            yield full, item


def _texts(h5py: Any, file: Any, dataset: Any) -> tuple[str, ...]:
    """The words of a list of texts, such as joints' names; nothing of other datasets."""
    if dataset.dtype.kind not in "OS" or dataset.dtype.names or not 1 < dataset.size <= MAX_WIDTH:
        return ()
    cells = dataset[()].ravel()
    if h5py.check_ref_dtype(dataset.dtype) is h5py.Reference:  # MATLAB's cells
        inner = [file[cell][()] for cell in cells if cell]
        return tuple("".join(map(chr, text.ravel())) for text in inner if text.dtype == np.uint16)
    return tuple(
        c.decode(errors="replace") if isinstance(c, bytes) else c for c in cells if isinstance(c, (bytes, str))
    )


def _leads_away(path: Path, name: str, found: str) -> GapError:
    hint = "copy it with what it refers to inside: h5repack, or h5py's File.copy(..., expand_external=True)"
    return GapError(
        "the file refers to another file", file=path, expected=f"{name} in the file itself", found=found, hint=hint
    )


def _runs(datasets: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Run -> signal -> dataset: by the outermost groups that are numbered, where several hold the same signals."""
    numbered: dict[str, dict[str, dict[str, Any]]] = {}
    for name, dataset in datasets.items():
        *groups, _ = name.split(".")
        for depth, group in enumerate(groups):
            if re.search(r"\d+$", group):
                stem = ".".join([*groups[:depth], re.sub(r"\d+$", "", group)])
                signal = ".".join(name.split(".")[depth + 1 :])
                numbered.setdefault(stem, {}).setdefault(group, {})[signal] = dataset
                break
    stem = max(numbered, key=lambda s: len(numbered[s]), default="")
    runs = numbered.get(stem, {})
    several = len(runs) > 1 and len({frozenset(signals) for signals in runs.values()}) == 1
    ordered = sorted(runs, key=lambda g: int(re.findall(r"\d+$", g)[0])) if several else []
    return {group: runs[group] for group in ordered} or {"": datasets}


def _numbers(datasets: dict[str, Any]) -> dict[str, F64]:
    found: dict[str, F64] = {}
    for name, dataset in datasets.items():
        values = dataset[()]
        if dataset.dtype.names:
            parts = {f"{name}.{n}": values[n] for n in dataset.dtype.names if dataset.dtype[n].base.kind in "fiub"}
        else:  # MATLAB writes columns as rows
            parts = {name: values.T if "MATLAB_class" in dataset.attrs else values}
        parts = {n: v if v.ndim <= 2 else v.squeeze() for n, v in parts.items()}
        found |= {n: np.asarray(v, dtype=np.float64) for n, v in parts.items() if v.ndim <= 2}
    return found


READER = Reader("hdf5", "an HDF5 file (.h5, .hdf5)", has_suffix(".h5", ".hdf5", ".hdf"), read)
