"""Tables of text, however their cells are parted (`realsim.core.text_table`)."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.text_table import FEW, TextTable, begin, first_lines, read_text_table
from realsim.core.types import F64
from realsim.gap.recordings.recording import Reader, Recording, Stream, no_samples, refuse_more
from realsim.gap.recordings.tables import labelled, named, on_one_clock, streams
from realsim.gap.recordings.vocabulary import plain, split_unit

_TAG = re.compile(r'[\w.]+\s*[=:]\s*"?([^",}]+)')
SUFFIXES = (".csv", ".tsv", ".txt", ".log", ".dat", ".lvm")


def recognise(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in SUFFIXES:
        return False
    lines = first_lines(path)
    if path.suffix.lower() == ".csv" and any(max(map(line.count, ",;\t")) for line in lines):
        return True
    return begin(lines)[1] < len(lines)


def read(path: Path) -> list[Recording]:
    found = read_text_table(path, lambda cell: split_unit(f"x [{cell}]")[1], lambda size: refuse_more(path, size), FEW)
    numbers = {n: v for n, v in found.columns.items() if np.isfinite(v).any()}
    dropped, columns = [n for n in found.parts if n and n not in numbers], _untagged(numbers)
    if not columns and found.columns:
        raise GapError("no column holds numbers", file=path, found=f"text in {', '.join(dropped[:8])}")
    if not columns:
        raise no_samples(path, "a header and one row per sample")
    notes = list(found.notes)
    names = list(columns)
    clocks = [k for k, n in enumerate(names[1:]) if names[k] == f"{n} time"]
    if clocks[:1] == [0]:  # each group of signals has a clock of its own
        of = {n: columns[names[max(c for c in clocks if c <= k)]] for k, n in enumerate(names) if k not in clocks}
        columns = on_one_clock({n: (t[np.isfinite(t)], columns[n][np.isfinite(t)]) for n, t in of.items()})
    stream = None if found.header else _echoed(path, found)
    made = (stream,) if stream else streams(path, columns, found.words, notes)
    dropped = [n for n in dropped if not any(f"({n}" in note for note in notes)]
    notes += [f"columns of text left out: {', '.join(dropped[:8])}"] if dropped else []
    made = tuple(_called(s, found.words) for s in made)
    odd = {n: cell for n, (cell, _) in found.odd.items() if n in numbers}
    notes += [f"{path.name}: {n} has values that are no numbers, the first is {c!r}" for n, c in odd.items()]
    return [Recording(path, path.stem, "csv", made, notes=tuple(notes))]


def _untagged(columns: Mapping[str, F64]) -> dict[str, F64]:
    """Columns named by a metric and its tags, `effort {joint="knee", host="a7"}`, without tags that all share."""
    tags = {n: _TAG.findall(n[n.find("{") :]) if "{" in n else [] for n in columns}
    shared = set.intersection(*(set(t) for t in tags.values() if t)) if any(tags.values()) else set()
    names = {n: " ".join([n.partition("{")[0].strip(), *(v for v in t if v not in shared)]) for n, t in tags.items()}
    apart = len(set(names.values())) == len(names)
    return {names[n] if apart and tags[n] else n: v for n, v in columns.items()}


def _called(stream: Stream, words: Mapping[str, Sequence[str]]) -> Stream:
    """With the names of joints that stand in columns of text of their own, one word each: `rostopic echo -p`."""
    lists: dict[str, list[str]] = {}
    for name, cells_of in words.items():
        if len(set(cells_of)) == 1 and "name" in plain(name.rstrip("0123456789[]._")).split("_")[-1]:
            lists.setdefault(name.rstrip("0123456789[]._"), []).append(cells_of[0])
    return named(stream, list(lists.values()), anew=True)


def _echoed(path: Path, found: TextTable) -> Stream | None:
    """What `ros2 topic echo --csv` prints of sensor_msgs/JointState: stamp, frame, names, and as many positions,
    velocities and efforts; None for another table without a header.

    Raises:
        GapError: another message with names in it, of which nothing tells what its numbers are.
    """
    columns, (stamp, *rest) = found.columns, list(found.parts)
    nanoseconds = columns.get(rest[0]) if rest else None
    if nanoseconds is None or stamp not in columns or any(len(set(words)) > 1 for words in found.words.values()):
        return None
    names = [n for n in rest[2:] if n in found.words]
    numbers = rest[2 + len(names) :]
    whole = all(columns.get(n, np.zeros(0)).ndim == 1 and (columns[n] % 1 == 0).all() for n in (stamp, rest[0]))
    if not names or not whole or nanoseconds.min() < 0 or nanoseconds.max() >= 1e9:
        return None
    kinds = len(numbers) / len(names)
    if kinds not in (1, 2, 3) or any(n not in columns for n in numbers):
        raise GapError(
            "a ROS message without a header, as `ros2 topic echo --csv` prints it", file=path,
            expected="sensor_msgs/JointState: stamp, frame, names, and as many positions, velocities and efforts",
            found=f"{len(names)} names and {len(numbers)} numbers",
            hint="record with `ros2 bag record TOPIC`, or write the columns' names into a first line",
        )  # fmt: skip
    parts = {
        kind: np.stack([columns[n] for n in numbers[k * len(names) : (k + 1) * len(names)]], axis=1)
        for k, kind in enumerate(("position", "velocity", "effort")[: int(kinds)])
    }
    clock = {"stamp [s]": columns[stamp] + 1e-9 * nanoseconds}
    return labelled(path, clock, parts, [found.words[n][0] for n in names], "sensor_msgs/msg/JointState")


READER = Reader("csv", "a .csv, .tsv, .txt, .dat, .lvm or .log table", recognise, read)
