"""A file or a folder -> its recordings, one a run."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, MissingExtraError, RealsimError
from realsim.core.files import check_size, read_json
from realsim.core.progress import track
from realsim.core.text_table import first_lines
from realsim.gap.recordings.jumps import cut, unbroken
from realsim.gap.recordings.names import is_sent, seconds_of
from realsim.gap.recordings.readers import READERS
from realsim.gap.recordings.recording import NO_SAMPLES, Field, Reader, Recording, Stream, Window, facts_of, no_samples
from realsim.gap.recordings.signals import at, held
from realsim.gap.recordings.tables import table
from realsim.gap.recordings.vocabulary import KINDS, SIDES, SIGNALS, english, plain

MAX_RUNS = 400
MAX_BYTES = 64 * 2**30
AS_A_TABLE = "save it as .csv or .parquet with a column of time and one for each signal (docs/logs.md)"

EXPORTS = {
    ".tdms": 'pip install nptdms pandas; python -c "from nptdms import TdmsFile; '
    "TdmsFile('{path}').as_dataframe(time_index=True).to_csv('log.csv')\""
}
"""What makes a table of files that are not read, by their ending."""


def read(path: Path, window: Window | None = None) -> list[Recording]:
    """The recordings in a file or a folder, one a run.

    A folder is one recording where a reader knows it as such (a ROS 2 bag, a LeRobot dataset); otherwise each file in
    it that a reader knows is a run, and so is each folder in it. Tables of different signals over the same seconds are
    one run.

    Raises:
        GapError: nothing that any reader knows, or a file that its reader cannot read.
        MissingExtraError: the reader's package is not installed.
    """
    path = Path(path)
    window = window or Window()
    if not path.exists():
        raise GapError("no such recording", file=path, expected="a file or a folder of recordings")
    reader = reader_of(path)
    if reader is not None:
        return _read(reader, path, window)
    if path.is_dir():
        return _folder(path, window)
    raise _empty(path) if path.is_file() and not path.stat().st_size else unknown(path)


def reader_of(path: Path) -> Reader | None:
    """The first reader that knows this file or folder."""
    return next((READERS[name] for name in READERS if READERS[name].recognise(path)), None)


def unknown(path: Path) -> GapError:
    """The error for what no reader knows; of a text with a line of it."""
    lines = [line.strip() for line in first_lines(path) if line.strip()] if path.is_file() else []
    return GapError(
        "not a recording that realsim can read",
        file=path,
        expected="; ".join(READERS[name].looks_for for name in READERS),
        found=(path.suffix or "no file ending") + (f", lines as {lines[len(lines) // 2][:120]!r}" if lines else ""),
        hint=EXPORTS.get(path.suffix.lower(), AS_A_TABLE).format(path=path),
    )


def _empty(path: Path) -> GapError:
    return GapError("the file is empty", file=path, expected="a recording", hint="copy it again, or record it again")


def _read(reader: Reader, path: Path, window: Window) -> list[Recording]:
    if path.is_file():
        check_size(path, MAX_BYTES)
        if path.stat().st_size == 0:
            raise _empty(path)
    else:  # a reader's library would wait for ever at a pipe in place of one of its files
        for inner in path.rglob("*"):
            if not inner.is_dir():
                check_size(inner, MAX_BYTES)
    beside = path.with_suffix(".json")  # what a logger says of its table: a rate, gains
    shared = _facts(beside) if beside != path and path.is_file() and beside.is_file() else {}
    read_ = reader.read(path, window) if reader.cuts else [cut(r, window) for r in reader.read(path)]
    whole = [replace(r, streams=filled, facts={**shared, **r.facts}) for r in read_ if (filled := _filled(r))]
    found = [_finite(replace(part, streams=_filled(part))) for r in whole for part in unbroken(r)]
    if not found:
        raise no_samples(path, "samples in the window of time", window=window)
    return found


def _facts(path: Path) -> dict[str, Any]:
    """What a file of JSON says that holds no samples; nothing of another one."""
    try:
        value = read_json(path)
    except RealsimError:
        return {}
    return facts_of(value) if isinstance(value, dict) else {}


def _filled(recording: Recording) -> tuple[Stream, ...]:
    """The streams that have samples; of a window of time some may have none."""
    return tuple(s for s in recording.streams if s.count)


def _finite(recording: Recording) -> Recording:
    """Infinite numbers are no measurements: missing, and reported."""
    notes, streams = [], []
    for stream in recording.streams:
        fields = {}
        for name, part in stream.fields.items():
            infinite = np.isinf(part.values)
            if infinite.any():
                count, where = int(infinite.sum()), stream.name or recording.path.name
                notes.append(f"{where}: {count} infinite values of {name} are taken as missing")
                part = replace(part, values=np.where(infinite, np.nan, part.values))
            fields[name] = part
        streams.append(replace(stream, fields=fields))
    if not notes:
        return recording
    return replace(recording, streams=tuple(streams), notes=(*recording.notes, *notes))


def _folder(folder: Path, window: Window) -> list[Recording]:
    files = sorted(p for p in folder.iterdir() if not p.name.startswith("."))
    known = [(p, r) for p in files if (r := reader_of(p)) is not None]
    if len(known) > MAX_RUNS:
        raise GapError("too many recordings", file=folder, expected=f"at most {MAX_RUNS}", found=str(len(known)))
    found: list[Recording] = []
    lost = [f"{p.name}: the file is empty" for p in files if p.is_file() and not p.stat().st_size and not reader_of(p)]
    first: RealsimError | None = None
    for path, reader in track(known, "reading", len(known)):
        try:
            found += _read(reader, path, window)
        except MissingExtraError:
            raise
        except RealsimError as error:
            first = error if first is None or first.message == NO_SAMPLES else first
            lost.append(f"{path.name}: {error.message}")
    merged = joined(found) if found else []
    if not found and (first is None or first.message == NO_SAMPLES):  # settings may lie beside the folders of runs
        merged = _inner(files, window)
    if not merged:
        raise first or GapError(
            "no recording in the folder",
            file=folder,
            expected="; ".join(READERS[name].looks_for for name in READERS),
            found=", ".join(p.name for p in files[:8]) or "an empty folder",
            hint=AS_A_TABLE if files else None,
        )
    return [replace(r, notes=r.notes + tuple(lost)) if i == 0 else r for i, r in enumerate(merged)]


def _inner(files: Sequence[Path], window: Window) -> list[Recording]:
    """The recordings in folders that are runs; none where no folder holds any."""
    folders = [p for p in files if p.is_dir() and any(reader_of(f) is not None for f in p.iterdir())]
    found: list[Recording] = []
    for folder in folders[:MAX_RUNS]:
        inside = _folder(folder, window)
        names = [folder.name] if len(inside) == 1 else [f"{folder.name}_{r.name}" for r in inside]
        found += [replace(r, name=name) for r, name in zip(inside, names, strict=True)]
    return found


def joined(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with those joined that hold different signals of one run: commands here, states there.

    They are named alike but for words of signals (`run1_cmd`, `run1_state`), or each of the folder's files holds
    something else; and they run over the same seconds.
    """
    if (merged := _a_file_a_joint(recordings)) is not None:
        return [merged]
    groups: dict[str, list[Recording]] = {}
    for recording in recordings:
        groups.setdefault(_bare(recording.name), []).append(recording)
    if len({_layout(r) for r in recordings}) == len(recordings):
        groups = {_bare(recordings[0].name) if len(groups) == 1 else "": list(recordings)}
    result: list[Recording] = []
    for name, parts in groups.items():
        apart = len(parts) > 1 and len({_layout(p) for p in parts}) == len(parts)
        if not (apart and all(len(p.streams) == 1 for p in parts) and _one_clock(parts)):
            result += parts
            continue
        halves = [_half(p) for p in parts]
        lone = halves.count("") == 1  # a run's name would be another one in each
        names = [half or ("" if lone else p.name) for half, p in zip(halves, parts, strict=True)]
        names = names if len(set(names)) == len(names) else [p.name for p in parts]
        streams = tuple(_of_joints(replace(p.streams[0], name=n)) for n, p in zip(names, parts, strict=True))
        files = ", ".join(p.name for p in parts)
        notes = (*(n for p in parts for n in p.notes), f"{files} are taken as one run")
        result.append(replace(parts[0], name=name or parts[0].name, streams=streams, notes=notes))
    return result


def _a_file_a_joint(recordings: Sequence[Recording]) -> Recording | None:
    """Files of one joint each as one run, where a clock that does not begin at zero shows that they ran at once."""
    single = all(len(r.streams) == 1 and all(f.width == 1 for f in r.streams[0].fields.values()) for r in recordings)
    if len(recordings) < 2 or not single or len({_layout(r) for r in recordings}) > 1 or not _one_clock(recordings):
        return None
    streams = [r.streams[0] for r in recordings]
    times = [seconds_of(*next(iter(s.clocks.items())))[0] for s in streams]
    if any((np.diff(t) <= 0).any() for t in times) or min(t[0] for t in times) < 10 * max(np.ptp(t) for t in times):
        return None
    columns = {
        f"{name} {r.name}": (held if is_sent(name) else at)(t, f.values, times[0])[:, 0]
        for r, s, t in zip(recordings, streams, times, strict=True)
        for name, f in s.fields.items()
    }
    stream = table(recordings[0].path, "", {"time [s]": times[0], **columns})
    notes = (*(n for r in recordings for n in r.notes), f"{', '.join(r.name for r in recordings)} are taken as one run")
    return replace(recordings[0], streams=(stream,), notes=notes)


def _bare(name: str) -> str:
    """A file's name without its words of signals: `run1_motor_state` -> run_1."""
    return "_".join(w for w in plain(name).split("_") if not set(english(w)) & {*SIDES, *KINDS, "joint"})


def _half(recording: Recording) -> str:
    """Name of a table among those of its run: the words of signals in its file's name, the same in all runs."""
    return "_".join(w for w in english(recording.name) if w in (*SIDES, *KINDS))


def _of_joints(stream: Stream) -> Stream:
    """A table of whose columns none says what it holds, so that its file's name does: they are joints of one field."""
    alone = stream.fields.items()
    if (
        not stream.name
        or len(alone) < 2
        or any(f.width > 1 or f.unit or set(english(n)) & set(SIGNALS) for n, f in alone)
    ):
        return stream
    values, names = np.concatenate([f.values for _, f in alone], axis=1), tuple(n for n, _ in alone)
    return replace(stream, fields={stream.name: Field(values, names, "", names)})


def _layout(recording: Recording) -> tuple[str, ...]:
    """What tells tables of different signals: their columns, and which side of the loop the file's name is of."""
    side = [w for w in english(recording.name) if w in SIDES]
    return (*side, *(n for s in recording.streams for n in s.fields))


def _one_clock(parts: Sequence[Recording]) -> bool:
    """Whether the tables run over the same seconds."""
    spans = []
    for part in parts:
        name, clock = next(iter(part.streams[0].clocks.items()), ("", None))
        if clock is None or not len(clock):
            return False
        seconds = seconds_of(name, clock)[0]
        spans.append((float(seconds[0]), float(seconds[-1])))
    length = max(b - a for a, b in spans)
    first, last = [a for a, _ in spans], [b for _, b in spans]
    return max(first) - min(first) < 0.1 * length and max(last) - min(last) < 0.1 * length
