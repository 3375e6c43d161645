"""Which time a sample has: the clocks of a stream compared, their offset and drift, and one time for all streams.

The stamp nearest to the measurement is used: the message's own, else a counter of the device, else the time at which
the message was received. Where a stamp runs on another clock than the receiver, it is laid on the receiver's by a
straight line through the messages of least delay; what a message took on its way only adds to that.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from shlex import quote
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.recordings.jumps import JUMP, own_clocks, shifts
from realsim.gap.recordings.names import seconds_of
from realsim.gap.recordings.recording import Recording, Stream, planned
from realsim.gap.recordings.vocabulary import TIMES, plain

_RATES = {"hz", "fps", "rate", "freq", "frequency"}
_STEPS = {"dt", "ts", "timestep", "period"}
_OF_SAMPLES = {"step", "control", "action", "policy", "sample", "sampling", "log", "logging", "record", "data", "loop"}
"""Words of a rate, of the s between two samples, and of what it is the rate of: a simulator's or a camera's is not."""
SAME_CLOCK = 0.5
"""s of offset up to which two clocks may be one and the offset the time on the way."""


@dataclass(frozen=True)
class Clocked:
    """The time of a stream's samples, s, and how it was found."""

    time: F64
    clock: str
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def clocked(recording: Recording) -> dict[str, Clocked]:
    """Stream -> the time of its samples on the recording's common clock.

    Raises:
        GapError: streams without any clock beside streams with one.
    """
    return {stream.name: _of_stream(recording, stream) for stream in recording.streams}


def _of_stream(recording: Recording, stream: Stream) -> Clocked:
    notes: list[str] = []
    warnings: list[str] = []
    receive = stream.clocks.get("receive")
    if receive is not None and not np.isfinite(receive).any():
        receive = None
    for name in own_clocks(stream):
        raw = stream.clocks[name]
        why = _unfit(raw)
        if why:
            notes.append(f"clock {name!r} is not used: {why}")
            continue
        if receive is None:
            seconds, how = (raw, "s") if name == "header" else seconds_of(name, raw)
            return Clocked(seconds, name, (*notes, f"time is {name!r}{'' if how == 's' else f', in {how}'}"))
        seconds, how = (raw, "s") if name == "header" else _unit_by(raw, receive)
        aligned, report, bad = _laid_on(seconds, receive)
        if bad:
            warnings.append(f"clock {name!r} of {stream.name} is not used: {bad}")
            continue
        return Clocked(aligned, name, (*notes, f"time is {name!r}{'' if how == 's' else f' in {how}'}: {report}"),
                       tuple(warnings))  # fmt: skip
    if receive is not None:
        return Clocked(receive, "receive", (*notes, "time is when messages were received"), tuple(warnings))
    rate, name = declared_rate(recording.facts)
    if rate:
        text = f"no clock: {rate:g} samples per second are declared ({name})"
        return Clocked(np.arange(stream.count) / rate, "rows", (text,))
    raise GapError(
        f"{stream.name or recording.name} has no time",
        file=recording.path,
        expected="a column that rises evenly (under any name), or one named time, timestamp, stamp or t",
        found="; ".join(
            [", ".join(c for f in stream.fields.values() for c in f.columns) or ", ".join(stream.fields), *notes]
        )[:300],
        hint=f"name its column: realsim log {quote(str(recording.path))} --use time=COLUMN; or, of even samples, give "
        "their rate in Hz: --rate 100",
    )


def declared_rate(facts: Mapping[str, Any]) -> tuple[float, str]:
    """(Hz, the fact that says so) of samples without a clock; 0 where none does, or several disagree."""
    found: dict[str, float] = {}
    for name, value in facts.items():
        words = {*plain(name.rpartition(".")[2]).split("_")}
        if not isinstance(value, (int, float)) or not value > 0:
            continue
        if name == "rate":  # of the user
            return float(value), name
        if words & (_RATES | _STEPS) and words <= _OF_SAMPLES | _RATES | _STEPS:
            found[name] = float(value) if words & _RATES else 1 / float(value)
    own = {n: hz for n, hz in found.items() if set(plain(n.rpartition(".")[2]).split("_")) & _OF_SAMPLES} or found
    agree = bool(own) and max(own.values()) < 1.01 * min(own.values())
    return (next(iter(own.values())), next(iter(own))) if agree else (0.0, "")


def _unit_by(raw: F64, receive: F64) -> tuple[F64, str]:
    """A counter in s by the receiver's clock: the unit whose seconds are the receiver's."""
    span, own = (float(np.median(np.abs(np.diff(c)))) for c in (receive, raw))  # a jump does not matter to these
    ratio = own / span if span > 0 else 1.0
    unit = min(TIMES, key=lambda u: abs(np.log(max(ratio, 1e-12) * TIMES[u])))
    return raw * TIMES[unit], unit


def _unfit(raw: F64) -> str:
    """Why a clock tells nothing, or an empty text."""
    good = raw[np.isfinite(raw)]
    if len(raw) < 2:
        return "it has one sample"
    if len(good) < max(2, 0.9 * len(raw)):
        return "most samples have no stamp"
    steps = np.diff(good)
    if not (good != 0).any() or not (steps != 0).any():
        return "it stands still"
    if (steps == 0).mean() > 0.5:
        return "most stamps repeat the one before: a row a joint? each joint needs a column of its own"
    if (steps < 0).mean() > 0.05:
        return "it runs backwards"
    return ""


def _laid_on(own: F64, receive: F64) -> tuple[F64, str, str]:
    """(own clock on the receiver's, what was found, why it cannot be used)."""
    good = np.isfinite(own) & np.isfinite(receive)
    base, slope, scatter = _least_delay(own[good], (receive - own)[good])
    start = own[good][0]
    rest = receive - own - base - slope * (own - start)
    ahead = rest < -JUMP  # received before it was stamped: a wrong stamp, where there are few
    jumps = len(shifts(own, receive))
    low, high = np.nanpercentile(rest, [1, 99])
    if not jumps and (high - low > 5 * JUMP or ahead.mean() > 0.01):
        jumps = int((np.abs(np.diff(rest)) > JUMP).sum())
    if jumps:
        return own, "", f"it jumps against the receiver's clock ({jumps} times by more than {JUMP:g} s)"
    own, rest = np.where(ahead, np.nan, own), rest[good & ~ahead]
    wait = f"messages wait {1e3 * np.median(rest):.3g} ms (p99 {1e3 * np.percentile(rest, 99):.3g}) beyond the least"
    span = float(np.ptp(own[good & ~ahead]))
    drifts = abs(slope) * span > max(3 * scatter, 1e-3)
    drift = f", drifts by {1e6 * slope:.3g} ppm" if drifts else ", no drift seen"
    if abs(base) < SAME_CLOCK and not drifts:
        return own, f"{1e3 * base:.3g} ms before it is received at least{drift}; {wait}", ""
    line = own + base + (slope * (own - start) if drifts else 0.0)
    off = f"off by {base:.6g} s" if abs(base) < 1e8 else "counted from its own start"
    return line, f"its clock is {off}{drift}: laid on the receiver's; {wait}", ""


def _least_delay(own: F64, delay: F64) -> tuple[float, float, float]:
    """(s, s per s, s of scatter) of the line along the least delays, from the least of each of fifty stretches."""
    parts = np.array_split(np.arange(len(own)), min(50, max(len(own) // 10, 1)))
    lowest = np.array([p[np.argmin(delay[p])] for p in parts if len(p)])
    t, d = own[lowest] - own[0], delay[lowest]
    if len(lowest) < 3 or np.ptp(t) <= 0:
        return float(delay.min()), 0.0, float(np.std(d))
    i, j = np.triu_indices(len(t), 1)
    slope = np.median((d[j] - d[i])[t[j] > t[i]] / (t[j] - t[i])[t[j] > t[i]])  # Theil 1950, Sen 1968: late messages...
    base = np.median(d - slope * t)  # ...do not matter
    rest = d - base - slope * t
    return float(base + np.min(rest[rest > -JUMP])), float(slope), float(np.median(np.abs(rest)))


def increasing(time: F64, values: F64, kind: str) -> tuple[F64, F64]:
    """Samples in the order of their time, the newest of equal ones; those without a time are left out.

    A trajectory that replaces another before its end takes the place of what was still to come.
    """
    good = np.isfinite(time)
    time, values = time[good], values[good]
    if planned(kind):
        later = np.minimum.accumulate(np.append(time, np.inf)[::-1])[::-1][1:]
        time, values = time[time < later], values[time < later]
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    keep = np.concatenate([np.diff(time) > 0, [True]]) if len(time) else np.zeros(0, bool)
    return time[keep], values[keep]
