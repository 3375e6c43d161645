"""A clock that jumps: where it does, the recording is cut, and each stretch between jumps is a run of its own.

Nothing tells for sure the time between the last sample before a jump and the first after it, and a run does not need
it. A step back is seen in the order of the samples. A step ahead looks like a pause; beside a stamp of another clock it
is told from one, and the clock at fault is the one whose step there is not a usual one. Where stamps run on while the
clock of reception jumps, that jump is taken back, so that both stay as far apart as they were.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.recordings.names import seconds_of
from realsim.gap.recordings.recording import Recording, Stream, Window, part_of, planned

JUMP = 0.1
"""s by which a clock steps aside. Messages of one topic do not overtake each other by as much."""
STEADY = 1.0
"""s before and after a jump in which messages wait as long as before: those behind a late one wait less and less."""
PAUSE = 1.0
"""s without a sample of any stream after which a run ends: what was commanded in between is not known."""
LEAST = 4
"""Samples on each side of a jump."""
MOST = 400


def unbroken(recording: Recording) -> list[Recording]:
    """The recording, or where its clock jumps, its stretches between jumps.

    Streams that do not show the jumps (too slow, or without a stamp to compare with) are cut by the times of the one
    that shows most, and by the order in the file; samples that may still lie on either side are left out.

    Raises:
        GapError: the clock jumps more often than a recording may have runs.
    """
    breaks = {s.name: found for s in recording.streams if not planned(s.type) and (found := _breaks(s))}
    how = "jumps" if breaks else "jumps ahead, or recording paused"
    breaks = breaks or _pauses(recording)
    if not breaks:
        return [recording]
    guide = max((s for s in recording.streams if s.name in breaks), key=lambda s: (len(breaks[s.name]), s.count))
    found = breaks[guide.name]
    if len(found) >= MOST:
        raise GapError(
            f"the clock of {guide.name or 'the table'} jumps or pauses {len(found)} times", file=recording.path,
            expected=f"at most {MOST} runs", hint="record again with a clock that nothing sets",
        )  # fmt: skip
    name, clock = _base(guide)
    steps = [k for k, _, _ in found]
    spans = [(float(np.nanmin(part)), float(np.nanmax(part))) for part in np.split(clock, steps)]
    back = np.cumsum([0.0, *(size if alone else 0.0 for _, size, alone in found)])
    parts: list[list[Stream]] = [[] for _ in spans]
    for stream in recording.streams:
        own = [k for k, _, _ in breaks.get(stream.name, ())]
        if len(own) == len(found):
            at = _stretch(np.arange(stream.count), own)
        else:
            by_order = _stretch(stream.order, guide.order[steps]) if len(guide.order) else np.zeros(0)
            at = _by_time(_base(stream)[1], spans, by_order)
        for i, part in enumerate(parts):
            part.append(_rows(stream, np.flatnonzero(at == i), back[i]))
    sizes = ", ".join(f"{size:+.3g} s" for _, size, _ in found[:4]) + (", ..." if len(found) > 4 else "")
    what = "the clock of reception" if name == "receive" else f"the clock of {guide.name or recording.path.name}"
    note = f"{what} {how} ({sizes}): each stretch is a run, {len(spans)} in all"
    return [
        replace(recording, name=f"{recording.name}_{i + 1}", streams=tuple(part), notes=(*recording.notes, note))
        for i, part in enumerate(parts)
    ]


def cut(recording: Recording, window: Window) -> Recording:
    """The samples that lie in a window, of each stream after its first one."""
    if window.whole:
        return recording
    streams = []
    for stream in recording.streams:
        clock = _base(stream)[1]
        if not len(clock):
            columns = ", ".join(list(stream.fields)[:12])
            raise GapError("a time window is requested, but the table has no time", file=recording.path, found=columns)
        since = clock - np.nanmin(clock)
        inside = (since >= window.start) & (since < window.start + window.seconds)
        streams.append(part_of(stream, inside))
    return replace(recording, streams=tuple(streams))


def shifts(own: F64, receive: F64) -> list[tuple[int, float]]:
    """(first sample after it, s) of each jump of one clock against another, both in s and in the order of samples."""
    good = np.flatnonzero(np.isfinite(own) & np.isfinite(receive))
    delay = (receive - own)[good]
    if len(delay) < 2 * LEAST:
        return []
    around = max(2 * LEAST, round(STEADY / max(float(np.median(np.abs(np.diff(own[good])))), 1e-6)))
    found = []
    for k in np.flatnonzero(np.abs(np.diff(delay)) > JUMP) + 1:
        sides = [delay[max(k - around, 0) : k], delay[k : k + around]]
        if min(map(len, sides)) < LEAST:
            continue
        (a, b), (c, d) = ((float(h.min()) for h in np.array_split(side, 2)) for side in sides)
        if abs(a - b) < JUMP / 2 and abs(c - d) < JUMP / 2 and abs(min(c, d) - min(a, b)) > JUMP:
            found.append((int(good[k]), min(c, d) - min(a, b)))
    return found


def _pauses(recording: Recording) -> dict[str, list[tuple[int, float, bool]]]:
    """As `_breaks`, of the stream with most samples: where nothing at all was recorded for long."""
    clocks = {s.name: _base(s)[1] for s in recording.streams}
    name = max(clocks, key=lambda n: len(clocks[n]), default="")
    if len(clocks.get(name, ())) < 2 * LEAST:
        return {}
    step = np.diff(clocks[name])
    found = []
    for k in np.flatnonzero(step > max(PAUSE, 10 * float(np.nanmedian(step)))) + 1:
        low, high = clocks[name][k - 1], clocks[name][k]
        if not any(((c > low + JUMP) & (c < high - JUMP)).any() for c in clocks.values()):
            found.append((int(k), float(step[k - 1]), False))
    return {name: found} if found else {}


def steps_back(clock: F64) -> list[int]:
    """The first sample after each step back of a clock in s; a single stamp that is off is none."""
    low, high = np.minimum(clock[:-1], clock[1:]), np.maximum(clock[:-1], clock[1:])
    return [int(k) + 2 for k in np.flatnonzero(high[2:] < low[:-2] - JUMP)]


def _breaks(stream: Stream) -> list[tuple[int, float, bool]]:
    """(first sample after it, s, whether the messages' own stamps run on) of each jump of a stream's clock."""
    name, clock = _base(stream)
    if len(clock) < 2 * LEAST:
        return []
    found = {int(k): (float(clock[k] - clock[k - 1]), False) for k in steps_back(clock)}
    if name == "receive" and "header" in stream.clocks:
        header = stream.clocks["header"]
        usual = float(np.median(np.abs(np.diff(clock))))
        for k, size in shifts(header, clock):
            if abs(clock[k] - clock[k - 1] - usual) > abs(header[k] - header[k - 1] - usual):
                found[k] = size, True
    return [(k, *found[k]) for k in sorted(found)]


def _base(stream: Stream) -> tuple[str, F64]:
    """The clock that a stream is laid on, s: the time of reception, else its first."""
    receive = stream.clocks.get("receive")
    if receive is not None and np.isfinite(receive).any():
        return "receive", receive
    return next(iter(own_clocks(stream).items()), ("", np.zeros(0)))


def own_clocks(stream: Stream) -> dict[str, F64]:
    """The messages' own clocks, s: the header's first, and a counter that wraps after one that runs on."""
    own = {n: c if n == "header" else seconds_of(n, c)[0] for n, c in stream.clocks.items() if n != "receive"}
    return dict(sorted(own.items(), key=lambda item: (item[0] != "header", bool(steps_back(item[1])))))


def _stretch(order: NDArray[np.int64], steps: Sequence[int] | NDArray[np.int64]) -> F64:
    """(T,) the stretch of each sample by its place in an order; (0,) where it has none."""
    return np.searchsorted(steps, order, side="right").astype(float)


def _by_time(clock: F64, spans: Sequence[tuple[float, float]], by_order: F64) -> F64:
    """(T,) the stretch whose time is nearest; of samples that may lie in several, that of the file's order, or NaN."""
    low, high = np.array(spans).T
    off = np.maximum(np.maximum(low - clock[:, None], clock[:, None] - high), 0.0)
    found = off.argmin(axis=1).astype(float)
    near = off <= off.min(axis=1, keepdims=True) + JUMP
    several = np.flatnonzero(near.sum(axis=1) > 1)
    found[several] = np.nan
    if len(by_order):
        here = several[near[several, by_order[several].astype(int)]]
        found[here] = by_order[here]
    return found


def _rows(stream: Stream, rows: NDArray[np.int64], back: float) -> Stream:
    """These samples, with the clock of reception set back, s."""
    joined = len(rows) > 0 and rows[-1] - rows[0] + 1 == len(rows)
    # A view: recordings may be as large as memory allows.
    taken = part_of(stream, slice(rows[0], rows[-1] + 1) if joined else rows)
    return replace(taken, clocks={n: c - (back if n == "receive" else 0.0) for n, c in taken.clocks.items()})
