"""Result of every reader: streams of numbers with names, labels, units and clocks, not yet interpreted."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, RealsimError
from realsim.core.types import F64

MAX_VALUES = 60_000_000
"""Numbers that a recording may hold in memory. Beyond, a window of time has to be requested. At the peak each takes 28
bytes (an MCAP of 3 million joint states, 75 million numbers: 2.1 GB)."""


NO_SAMPLES = "the recording has no samples"
MOST_FACTS = 200
"""Facts of one level that are kept."""


@dataclass(frozen=True)
class Field:
    """One signal of a stream."""

    values: F64
    """(T, K), as written in the file; a missing sample is NaN."""
    labels: tuple[str, ...] = ()
    """Names of the K columns (joints, axes), or () where the file does not say."""
    unit: str = ""
    """The unit, if the file or its message type specifies it."""
    columns: tuple[str, ...] = ()
    """Names of the table's columns that it was made of, or ()."""
    units: tuple[str, ...] = ()
    """Of each column, where they are not all in one."""

    @property
    def width(self) -> int:
        return int(self.values.shape[1])


def of_columns(values: F64, labels: tuple[str, ...], units: Sequence[str], columns: tuple[str, ...]) -> Field:
    """A field of columns that have a unit each."""
    alike = len(set(units)) == 1
    return Field(values, labels, units[0] if alike else "", columns, () if alike else tuple(units))


@dataclass(frozen=True)
class Stream:
    """One topic, or one table: samples that were taken together."""

    name: str
    """The topic, or the file's stem."""
    type: str
    """The message type (`sensor_msgs/msg/JointState`), or `table`."""
    clocks: Mapping[str, F64]
    """Clock -> (T,) as written. `receive` and `header` are s, others (`tick`, `timestamp`) in their own unit."""
    fields: Mapping[str, Field]
    order: Any = field(default_factory=lambda: np.zeros(0))
    """(T,) the place of each sample among those of all streams, in the order in which they were read; (0,) unknown."""

    @property
    def count(self) -> int:
        return len(next(iter(self.clocks.values()))) if self.clocks else len(next(iter(self.fields.values())).values)


@dataclass(frozen=True)
class Recording:
    """One run as it was recorded."""

    path: Path
    name: str
    """Of the run: a file stem, an episode."""
    reader: str
    streams: tuple[Stream, ...] = field(repr=False)
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Topic -> why it was not read."""
    notes: tuple[str, ...] = ()
    """Repairs and omissions while reading."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Metadata of the file: robot, rate, gains."""
    depth: Mapping[str, Any] = field(default_factory=dict)
    """Topic of depth frames -> its camera (`realsim.gap.recordings.depth.DepthTopic`)."""


@dataclass(frozen=True)
class Window:
    """Part of a recording to read."""

    start: float = 0.0
    """s after the first message."""
    seconds: float = float("inf")

    def __post_init__(self) -> None:
        if not (self.start >= 0 and self.seconds > 0):
            raise GapError("the window is empty", expected="--skip 0 or more, --seconds above 0", found=str(self))

    def holds(self, since: float) -> bool:
        """Whether a moment, s after the first one, lies in the window."""
        return self.whole or self.start <= since < self.start + self.seconds

    @property
    def whole(self) -> bool:
        return self.start == 0 and np.isinf(self.seconds)


WHOLE = Window()


@dataclass(frozen=True)
class Reader:
    """One format: one file in `readers/`, one line in `READERS`."""

    name: str
    looks_for: str
    """Its distinctive features, for the message if nothing is recognised."""
    recognise: Callable[[Path], bool]
    """A cheap look at names and first bytes; must not raise for any other file."""
    read: Callable[..., list[Recording]]
    """Of a path, the whole; or of a path and a window, the part in it."""
    cuts: bool = False
    """Whether `read` takes a window, so that what lies outside it does not fill the memory."""


def facts_of(value: Mapping[str, Any], place: str = "") -> dict[str, Any]:
    """Numbers and words of what describes a recording, by dotted names; of a text of JSON, those in it."""
    found: dict[str, Any] = {}
    for name, item in islice(value.items(), MOST_FACTS):
        full, inner = f"{place}.{name}".lstrip("."), item.item() if isinstance(item, np.generic) else item
        if isinstance(inner, str) and inner.lstrip().startswith("{"):
            with suppress(ValueError, RecursionError):
                found |= facts_of(json.loads(inner), place)
                continue
        if isinstance(inner, Mapping):
            found |= facts_of(inner, full)
        elif isinstance(inner, (int, float, str)):
            found[full] = inner[:200] if isinstance(inner, str) else inner
    return found


def refuse_more(path: Path, values: int) -> None:
    """Stop where a recording would not fit into memory."""
    if values > MAX_VALUES:
        raise GapError(
            "the recording is too large to be read at once",
            file=path,
            expected=f"at most {MAX_VALUES:,} numbers",
            hint="read a part of it: --skip 30 --seconds 60",
        )


def no_samples(
    path: Path, what: str, skipped: Mapping[str, str] | None = None, window: Window = WHOLE, notes: Sequence[str] = ()
) -> GapError:
    """The error for a file without anything numeric; says which topics there were."""
    there = "; ".join([*(f"{name} ({why})" for name, why in list((skipped or {}).items())[:12]), *notes[:2]])
    hint = None if window.whole else "does --skip lie beyond its end? `realsim log` without it reads the whole"
    return GapError(NO_SAMPLES, file=path, expected=what, found=there or "nothing", hint=hint)


def part_of(stream: Stream, rows: Any) -> Stream:
    """These samples of a stream."""
    fields = {n: replace(f, values=f.values[rows]) for n, f in stream.fields.items()}
    order = stream.order[rows] if len(stream.order) else stream.order
    return replace(stream, clocks={n: c[rows] for n, c in stream.clocks.items()}, fields=fields, order=order)


@contextmanager
def readable(path: Path, kind: str, expected: str | None = None) -> Iterator[None]:
    """Errors of a reader's library, and what damage leads to, as one about a file of this kind."""
    try:
        yield
    except RealsimError:
        raise
    except Exception as error:  # each library has its own
        found = f"{type(error).__name__}: {error}"[:160]
        raise GapError(f"not a readable {kind}", file=path, expected=expected, found=found) from error


def planned(kind: str) -> bool:
    """Whether messages of a type hold points of a plan, each with a time to come."""
    return kind.rsplit("/", 1)[-1] == "JointTrajectory"


def first_line(path: Path, limit: int = 65536) -> bytes:
    """The first bytes of a file up to its first line break; empty where it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(limit).split(b"\n", 1)[0]
    except OSError:
        return b""


def has_suffix(*suffixes: str) -> Callable[[Path], bool]:
    """A recogniser by file name."""

    def test(path: Path) -> bool:
        return path.is_file() and path.suffix.lower() in suffixes

    return test
