"""What the user knows better: `--use ROLE=FIELD`, `ROLE=COLUMN,COLUMN`, `time=COLUMN`, `ROLE=none`."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.errors import GapError, did_you_mean
from realsim.core.types import F64
from realsim.gap.recordings.names import ROLES
from realsim.gap.recordings.recording import Recording, Stream, of_columns
from realsim.gap.recordings.vocabulary import unit_of

TIME = "time"
SYNTAX = "ROLE=FIELD, ROLE=COLUMN,COLUMN,... (a leading - negates), time=COLUMN or ROLE=none"
_ITEM = re.compile(r"^(?P<field>.+)\[(?P<item>[^\[\]]+)\]$")


@dataclass(frozen=True)
class Use:
    """One `--use`, resolved against the first recording."""

    role: str
    stream: str = ""
    member: str = ""
    """The field, or empty for none."""


def apply(recordings: Sequence[Recording], texts: Sequence[str]) -> tuple[list[Recording], dict[str, Use]]:
    """(recordings with the fields and clocks that were named, role -> what it is made of).

    Raises:
        GapError: a text that is no `ROLE=...`, or a name that no recording has.
    """
    kept, uses = list(recordings), dict[str, Use]()
    for text in texts:
        role, equals, name = (part.strip() for part in text.partition("="))
        if not equals or role not in (*ROLES, TIME):
            raise GapError(
                f"--use {text!r} cannot be read", expected=f"{SYNTAX}; ROLE one of {', '.join((*ROLES, TIME))}",
                hint=did_you_mean(role, (*ROLES, TIME)),
            )  # fmt: skip
        if name == "none" and role != TIME:
            uses[role] = Use(role)
            continue
        found: Use | None = None
        error: GapError | None = None
        for i, recording in enumerate(kept):
            try:
                kept[i], use = _clock(recording, name) if role == TIME else _field(recording, role, name)
            except GapError as problem:
                error = error or problem
                continue
            found = found or use
        if found is None:
            assert error is not None
            raise error
        if role != TIME:
            uses[role] = found
    return kept, uses


def _field(recording: Recording, role: str, name: str) -> tuple[Recording, Use]:
    """A field as it is, or a new one of columns that are named one by one."""
    for stream in recording.streams:
        if name in (wanted := {**{n: n for n in stream.fields}, **{f"{stream.name}:{n}": n for n in stream.fields}}):
            return recording, Use(role, stream.name, wanted[name])
    parts = [_column(recording, part.strip()) for part in name.split(",")]
    homes = {stream.name for stream, *_ in parts}
    if len(homes) > 1:
        raise GapError(
            f"--use {role}={name} names columns of several streams", file=recording.path,
            expected="columns of one table or topic", found=", ".join(sorted(homes)),
        )  # fmt: skip
    stream = parts[0][0]
    values = np.stack([v for _, v, _, _ in parts], axis=1)
    labels = tuple(label for _, _, label, _ in parts)
    made = of_columns(values, labels if len(set(labels)) == len(labels) else (), [p[-1] for p in parts], labels)
    filled = replace(stream, fields={**stream.fields, name: made})
    streams = tuple(filled if s.name == stream.name else s for s in recording.streams)
    return replace(recording, streams=streams), Use(role, stream.name, name)


def _column(recording: Recording, text: str) -> tuple[Stream, F64, str, str]:
    """(stream, values (T,), label, unit) of one column: of a table, or FIELD[item] of a topic."""
    known = [clock for stream in recording.streams for clock in stream.clocks]
    for sign, name in ((1.0, text), (-1.0, text[1:])) if text.startswith("-") else ((1.0, text),):
        for stream in recording.streams:
            for member, field in stream.fields.items():
                names = field.columns if len(field.columns) == field.width else ()
                items = [*(field.labels or names), *map(str, range(field.width))]
                known += names or [f"{stream.name}:{member}".lstrip(":")]
                whole = name.removeprefix(f"{stream.name}:")
                match = _ITEM.match(whole)
                if whole in names:
                    return stream, sign * field.values[:, names.index(whole)], whole, unit_of(whole)
                if match and match["field"] == member and match["item"] in items:
                    k = items.index(match["item"]) % field.width
                    return stream, sign * field.values[:, k], match["item"], field.unit
    raise GapError(
        f"--use names {text!r}, which is not in the recording", file=recording.path,
        expected=f"one of {', '.join(dict.fromkeys(known[:60]))}", hint=did_you_mean(text, known),
    )  # fmt: skip


def _clock(recording: Recording, name: str) -> tuple[Recording, Use]:
    """The recording with one of its columns as the clock of its table."""
    for stream in recording.streams:
        if name in stream.clocks:
            clocks = {name: stream.clocks[name]}
            streams = tuple(replace(s, clocks=clocks) if s is stream else s for s in recording.streams)
            return replace(recording, streams=streams), Use(TIME, stream.name, name)
    stream, values, label, _ = _column(recording, name)
    if not (np.diff(values[np.isfinite(values)]) > 0).mean() > 0.5:
        raise GapError(f"{name!r} is no clock: it does not rise", file=recording.path, expected="a column of times")
    streams = tuple(replace(s, clocks={label: values}) if s.name == stream.name else s for s in recording.streams)
    return replace(recording, streams=streams), Use(TIME, stream.name, label)
