"""Tables into streams: columns that belong together become one field, by index, by axis, or by the joint they name."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.text_table import MAX_WIDTH, cells, odd_cell
from realsim.core.types import F64
from realsim.gap.case.units import UNITS
from realsim.gap.recordings.flatten import flatten
from realsim.gap.recordings.names import JOINTS, is_sent
from realsim.gap.recordings.recording import Field, Stream, no_samples, of_columns, refuse_more
from realsim.gap.recordings.signals import at, held
from realsim.gap.recordings.vocabulary import KINDS, SIDES, SIGNALS, english, is_clock, plain, split_unit, time_unit

_AXIS = re.compile(r"^(?P<stem>.*?)[._\s\[(]*(?P<axis>[xyzw])[\])]?$")
_INDEX = re.compile(r"^(?P<head>.*?)[._\s\[(]*(?P<index>\d+)[\])]?(?P<tail>[^0-9]*)$")
_COUNTS = {"index", "idx", "frame", "sample", "seq", "sequence", "count", "counter", "row", "line", "iteration", "iter"}
_COUNTS |= {"n", "no", "nr", "id", "step", "unnamed", "packet"}
"""Words of columns that count rows: they rise evenly, and give no seconds."""
EVEN = 0.9
"""Share of the steps of a clock within a third to three times the median one. Set by hand: loops of hobby boards that
wait for a serial port have 0.97 and more."""
LEAST_CLOCK = 20
"""Samples from which a column that rises evenly is taken for a clock."""


def table(path: Path, name: str, columns: Mapping[str, F64]) -> Stream:
    """A stream from columns (T,) or (T, K) of one table; clocks are those named so, else the one that rises evenly."""
    refuse_more(path, sum(v.size for v in columns.values()))
    columns = _joined_stamps(columns)
    (lone, matrix), *others = columns.items() or [("", np.zeros(0))]
    if not others and matrix.ndim == 2 and not _counts(matrix[:, 0]) and _clock_by_values({f"{lone}[0]": matrix[:, 0]}):
        columns = {f"{lone}[{k}]": v for k, v in enumerate(matrix.T)}  # Simulink's To File: the time, then signals
    scalars = {n: v for n, v in columns.items() if v.ndim == 1}
    clocks = {n: v for n, v in scalars.items() if is_clock(n)}
    stamps: dict[str, F64] = {}
    if not any(rises_evenly(v) for v in clocks.values()) and (found := _clock_by_values(scalars)):
        clocks = {found: scalars[found], **clocks}
        stamps = _stamps(scalars)
    rest = {n: v for n, v in columns.items() if n not in clocks and n not in stamps and v.ndim <= 2}
    vectors = {
        n: Field(v, (), split_unit(n)[1], (n,)) for n, v in rest.items() if v.ndim == 2 and 0 < v.shape[1] <= MAX_WIDTH
    }
    fields = vectors | grouped({n: v for n, v in rest.items() if v.ndim == 1})
    if not fields:
        raise GapError("the table has no columns of numbers", file=path, found=", ".join(list(columns)[:12]) or "none")
    return Stream(name, "table", clocks, fields)


def by_topic(path: Path, columns: Mapping[str, F64]) -> tuple[Stream, ...]:
    """The streams of a table: one; or, where each row fills the cells of one topic alone, one a topic (PlotJuggler)."""
    whole = {n: v for n, v in columns.items() if np.isfinite(v).all()}
    clock = next((n for n in whole if is_clock(n)), "")
    groups: dict[bytes, list[str]] = {}
    for name, values in columns.items():
        if name not in whole and values.ndim == 1:
            groups.setdefault(np.isfinite(values).tobytes(), []).append(name)
    rows = [np.frombuffer(mask, dtype=bool) for mask in groups]
    if not clock or len(groups) < 2 or (np.sum(rows, axis=0) > 1).mean() > 1 - EVEN:
        return (table(path, "", columns),)
    streams, usual = [], max(mask.sum() for mask in rows)
    for mask, names in zip(rows, groups.values(), strict=True):
        if mask.sum() > (1 - EVEN) * usual:  # beside words of a state that changes now and then
            topic = names[0][: max(names[0].find("/", 1), 0)]
            cells_of = {n: columns[n][mask] for n in (clock, *names)}
            streams.append(table(path, topic or names[0], cells_of))
    return tuple(streams)


def on_one_clock(signals: Mapping[str, tuple[Sequence[float] | F64, Sequence[float] | F64]]) -> dict[str, F64]:
    """Signals with clocks of their own, (times, values) each, as columns of one table; missing where they have none."""
    stamps = np.unique(np.concatenate([np.asarray(t) for t, _ in signals.values()]))
    found = {"time": stamps}
    for name, (times, values) in signals.items():
        first = np.unique(np.asarray(times), return_index=True)
        found[name] = _where_stamped(first[0], np.asarray(values)[first[1], None], stamps)[:, 0]
    return found


def labelled(
    path: Path, clock: Mapping[str, F64], parts: Mapping[str, F64], labels: Sequence[str], kind: str = "table"
) -> Stream:
    """A stream of fields (T, K) whose columns are those joints', at one clock (T,)."""
    stream = table(path, "", {**clock, **parts})
    named = {
        n: replace(f, labels=tuple(labels), columns=tuple(f"{n}_{label}" for label in labels))
        if n in parts and f.width == len(labels)
        else f
        for n, f in stream.fields.items()
    }
    return replace(stream, type=kind, fields=named)


def named(stream: Stream, lists: Sequence[Sequence[str]], *, anew: bool = False) -> Stream:
    """A stream whose fields without labels (`anew`: all) have those of a list of as many names beside them."""
    fields = dict(stream.fields)
    for labels in (tuple(found) for found in lists if len(set(found)) == len(found) > 1):
        fields = {
            n: replace(f, labels=labels) if (anew or not f.labels) and f.width == len(labels) else f
            for n, f in fields.items()
        }
    return replace(stream, fields=fields)


def streams(
    path: Path, columns: Mapping[str, F64], spelled: Mapping[str, Sequence[Any]], notes: list[str], name: str = ""
) -> tuple[Stream, ...]:
    """The streams of a table of (R,) or (R, K) numbers, beside columns of text or of lists of words."""
    words = {
        n: found
        for n, cells_of in spelled.items()
        if all(isinstance(c, str) for c in cells_of) and len(set(found := list(map(str.strip, cells_of)))) <= MAX_WIDTH
    }
    if fields := a_column_a_joint(columns, words, notes):
        return (replace(labelled(path, *fields), name=name),)
    lists = [c[0] for c in spelled.values() if isinstance(c[0], list) and c[0] == c[-1]]
    found_ = [named(s, [x for x in lists if all(isinstance(w, str) for w in x)]) for s in by_topic(path, columns)]
    return tuple(replace(s, name=f"{name} {s.name}".strip()) for s in found_)


def a_column_a_joint(
    columns: Mapping[str, F64], words: Mapping[str, Sequence[str]], notes: list[str]
) -> tuple[dict[str, F64], dict[str, F64], list[str]] | None:
    """(clock (T,), column -> (T, K), the K joints) of a table with a row a joint; None for any other one.

    Its rows name each of the joints in turn, or one joint after the other, each with a time of its own.

    Args:
        columns: (R,) or lists.
        words: column of text -> its R cells.
        notes: what is worth saying is added.
    """
    ids = {
        n: v
        for n, v in columns.items()
        if v.ndim == 1 and set(english(n)) <= {"joint", *_COUNTS} and (v % 1 == 0).all()
    }
    clock = next((n for n, v in columns.items() if n not in ids and v.ndim == 1 and is_clock(n)), "")
    tags = {n: found for n, found in words.items() if 1 < len(set(found)) <= MAX_WIDTH}
    both = [" ".join(row) for row in zip(*tags.values(), strict=True)]  # a side and a joint
    if len(tags) > 1 and max(len(set(found)) for found in tags.values()) < len(set(both)) <= MAX_WIDTH:
        words = {" ".join(tags): both, **words}
    for place, cells_of in {**words, **ids}.items() if clock else ():
        names, code = np.unique(np.array(cells_of), return_inverse=True)
        each = [np.flatnonzero(code == k) for k in range(len(names))]
        if not 1 < len(names) <= MAX_WIDTH or min(map(len, each)) < max(EVEN * max(map(len, each)), LEAST_CLOCK):
            continue
        turns, times = np.diff(code) != 0, columns[clock]
        in_turn = turns.mean() > EVEN and (code[len(names) :] == code[: -len(names)]).mean() > EVEN
        one_by_one = turns.sum() == len(names) - 1 and (np.diff(times)[turns] < 0).all()
        one_by_one = one_by_one and set(english(place)) & {"joint", "variable", "signal"}  # not a run after the other
        if not (in_turn or one_by_one) or not all(rises_evenly(times[rows]) for rows in each):
            continue
        order = sorted(range(len(names)), key=lambda k: each[k][0])
        # A motor and its joint stand side by side: each name of it can be the model's.
        beside = {w: {*zip(found, code.tolist(), strict=True)} for w, found in words.items() if len(found) == len(code)}
        alike = [w for w, pairs in beside.items() if len(pairs) == len(names) == len({*words[w]})]
        labels = [
            " / ".join(words[w][each[k][0]] for w in alike) if place in words else f"joint_{int(names[k])}"
            for k in order
        ]
        stamps = np.unique(times)
        together = len(stamps) < 1.5 * max(map(len, each))  # else each joint was read at a moment of its own
        stamps = stamps if together else times[each[order[0]]]
        notes.append(f"a row for each of {len(names)} joints ({place}): taken as a column for each")
        notes += (
            [] if together else [f"the joints were read one after another: all are put on the times of {labels[0]}"]
        )
        parts = {}
        for name, values in columns.items():
            if name not in (clock, place) and values.ndim == 1:
                put = _where_stamped if together else held if is_sent(name) else at
                made = np.concatenate([put(times[each[k]], values[each[k], None], stamps) for k in order], axis=1)
                parts[name] = np.round(made) if (values % 1 == 0).all() else made  # encoder steps stay whole
        if len(parts) == 1 and set(english(next(iter(parts)))) <= {
            "observation"
        }:  # variable and value: labels are signals
            (values,) = parts.values()
            return {clock: stamps}, dict(zip(labels, values.T, strict=True)), []
        return {clock: stamps}, parts, labels
    return None


def _where_stamped(times: F64, values: F64, wanted: F64) -> F64:
    """(T, K) of (N, K) values at the moments that they are of; missing at others."""
    found = np.full((len(wanted), values.shape[1]), np.nan)
    found[np.searchsorted(wanted, times)] = values
    return found


def as_long_as_most(arrays: Mapping[str, F64]) -> dict[str, F64]:
    """Of arrays (T,), (T, K) or (K, T), whatever lies beside them, those of as many samples as most, as columns.

    Samples are the longest side that half of the arrays share. Groups that all names begin with are left out of them.
    """
    flat = {n: v for n, v in arrays.items() if v.ndim in (1, 2) and max(v.shape, default=0) > 1}
    sides = Counter(n for v in flat.values() for n in {*v.shape} if n > 1)
    length = max((n for n in sides if 2 * sides[n] >= len(flat)), default=max(sides, key=lambda n: sides[n], default=0))
    turned = {n: v if len(v) == length else v.T for n, v in flat.items()}
    columns = {n: v[:, 0] if v.shape[1:] == (1,) else v for n, v in turned.items() if len(v) == length}
    parts = [n.split(".") for n in columns]
    depths = range(min(map(len, parts), default=1) - 1)
    shared = next((k for k in depths if len({p[k] for p in parts}) > 1), len(depths))
    return {".".join(p[shared:]): v for p, v in zip(parts, columns.values(), strict=True)}


def of_arrays(path: Path, arrays: Mapping[str, F64]) -> Stream:
    """The stream of a file of arrays by their names.

    Raises:
        GapError: none has a row a sample.
    """
    columns = as_long_as_most(arrays)
    if not columns:
        raise no_samples(path, "arrays with a row a sample", {n: str(v.shape) for n, v in arrays.items()})
    return table(path, "", columns)


def rises_evenly(values: F64) -> bool:
    """Whether a column (T,) can be a clock by its values alone."""
    if len(values) < LEAST_CLOCK or not np.isfinite(values).all():
        return False
    steps = np.diff(values)
    usual = float(np.median(steps))
    near = (steps > usual / 3) & (steps < 3 * usual)
    return usual > 0 and bool((steps >= 0).mean() > 0.98 and near.mean() > EVEN)


def _clock_by_values(columns: Mapping[str, F64]) -> str:
    """The column that rises evenly without being named for a signal or a count; one with a unit of time first."""
    found = [
        n for n, v in columns.items() if rises_evenly(v) and (_is_stamp(n) or not set(english(n)) & {*SIDES, *KINDS})
    ]
    found = [
        n for n in found if time_unit(n) or not (_counts(columns[n]) and (set(english(n)) & _COUNTS or not plain(n)))
    ]
    stamps = list(_stamps({n: columns[n] for n in found}).values())
    apart = max((float(np.ptp(row)) for row in np.transpose(stamps)), default=0.0) if len(stamps) > 1 else 0.0
    if apart > 0 and apart > 0.5 * np.median(np.diff(stamps[0])):
        return ""  # clocks of signals that were not sampled together
    return min(found, key=lambda n: (not time_unit(n), "time" not in english(n), _counts(columns[n])), default="")


def _stamps(columns: Mapping[str, F64]) -> dict[str, F64]:
    """Clocks of single signals: `positions.timestamps`."""
    return {n: v for n, v in columns.items() if _is_stamp(n) and rises_evenly(v)}


def _is_stamp(name: str) -> bool:
    """Whether a path ends in a clock: `/joint_states/header/stamp`, `/joint_states/header/stamp/sec`."""
    parts = re.split("[/.]", name)
    return any(is_clock(" ".join(parts[-k:])) for k in range(1, len(parts)))


def _counts(values: F64) -> bool:
    """Whether a column counts its rows."""
    return bool((np.diff(values) == 1).all())


def _joined_stamps(columns: Mapping[str, F64]) -> Mapping[str, F64]:
    """Seconds and nanoseconds in columns of their own as one clock: `stamp.sec`, `stamp.nanosec`."""
    result = dict(columns)
    for name, whole in columns.items():
        stem, unit = split_unit(name)
        for other, part in columns.items():
            rest, finer = split_unit(other)
            if unit == "s" and finer in ("ns", "us") and rest == stem and whole.ndim == part.ndim == 1:
                scale = {"ns": 1e-9, "us": 1e-6}[finer]
                if np.nanmin(part) >= 0 and np.nanmax(part) < 1 / scale:
                    result.pop(other, None)
                    result[name] = whole + scale * part
    return result


def grouped(scalars: Mapping[str, F64]) -> dict[str, Field]:
    """Columns (T,) as fields: `acc_x acc_y acc_z`, `q_0 q_1`, `FL_hip_pos FL_calf_pos`; others stay alone."""
    left = dict(scalars)
    found: dict[str, Field] = {}
    places = _by_place(left)
    among = [set(group.values()) for group, *_ in places]  # wrist_1_joint is a joint among others, q_1 is not
    indexed = [
        g
        for g in _by_index(left)
        if split_unit(g[1][0])[0].rstrip(")] ")[-1].isdigit() or not any(set(g[0].values()) < wide for wide in among)
    ]
    for group, labels, stem in (*_by_axis(left), *indexed, *places):
        members = [m for m in group.values() if m in left]
        if len(members) < len(group) or len(members) < 2:
            continue
        name = stem if stem and stem not in found else " ".join(members[:2])
        values = np.stack([left.pop(m) for m in members], axis=1)
        found[name] = of_columns(values, labels, [split_unit(m)[1] for m in members], tuple(members))
    return found | {n: Field(v[:, None], (), split_unit(n)[1], (n,)) for n, v in left.items()}


_Groups = list[tuple[dict[str, str], tuple[str, ...], str]]
"""(place -> column, places, what the columns have in common) of columns that belong together."""


def _by_axis(names: Mapping[str, Any]) -> _Groups:
    stems: dict[str, dict[str, str]] = {}
    for name in names:
        match = _AXIS.match(split_unit(name)[0])
        if match and match["stem"]:
            stems.setdefault(match["stem"], {})[match["axis"].lower()] = name
    # The order of the columns is kept: it is the order of a quaternion too.
    return [(axes, tuple(axes), stem) for stem, axes in stems.items() if {"x", "y", "z"} <= set(axes)]


def _by_index(names: Mapping[str, Any]) -> _Groups:
    stems: dict[tuple[str, str, str], dict[int, str]] = {}
    for name in names:
        bare, unit = split_unit(name)
        match = _INDEX.match(bare)
        if match and not match["tail"].strip("._ ").isdigit():
            stems.setdefault((match["head"], match["tail"], unit), {})[int(match["index"])] = name
    groups = []
    for (head, tail, unit), found in _across_units(stems).items():
        indices = sorted(found)
        if len(indices) >= 2 and indices == list(range(indices[0], indices[0] + len(indices))):
            labels = tuple(found[i] for i in indices)
            groups.append(({str(i): found[i] for i in indices}, labels, _named(head.rstrip("._ ") + tail, unit)))
    return groups


def _by_place(names: Mapping[str, Any]) -> _Groups:
    """Columns of which every name is a place and the same words of a signal: hip_pos, knee_pos; Knie_ist, Knie_soll."""
    stems: dict[tuple[str, tuple[str, ...], str], dict[str, str]] = {}
    bare: dict[str, str] = {}
    for name in names:
        topic = name[: name.find("/", 1) + 1] if name.startswith("/") else ""
        parts, unit = english(name[len(topic) :]), split_unit(name)[1]
        signal = tuple(w for w in parts if w in SIGNALS)
        place = "_".join(w for w in parts if w not in SIGNALS)
        if (signal or unit) and place:
            stems.setdefault((topic, signal, unit), {})[place] = name
        elif place:
            bare[topic + place] = name
    for (topic, signal, _), found in list(stems.items()):  # knee_cmd, knee: what is commanded, and what is
        if "target" in signal and len(found) >= 2 and all(topic + place in bare for place in found):
            stems.setdefault((topic, ("measured",), ""), {place: bare[topic + place] for place in found})
    return [
        (found, tuple(found), topic + _named("_".join(signal), unit))
        for (topic, signal, unit), found in _across_units(stems).items()
        if len(found) >= 2
    ]


def _across_units(stems: Mapping[tuple[Any, ...], dict[Any, str]]) -> dict[tuple[Any, ...], dict[Any, str]]:
    """Columns that only their unit keeps apart, of different joints, as one: slides in mm beside hinges in deg."""
    together: dict[tuple[Any, ...], dict[Any, str]] = {}
    units_of: dict[tuple[Any, ...], set[str]] = {}
    for (*stem, unit), found in stems.items():
        for key in [k for k in together if k[:-1] == tuple(stem) and not set(together[k]) & set(found)]:
            units = units_of[key] | {unit}
            if any(units <= set(UNITS[array]) for array in JOINTS):
                mixed = (*stem, "")
                together[mixed], units_of[mixed] = together.pop(key) | found, units
                break
        else:
            together[(*stem, unit)], units_of[(*stem, unit)] = found, {unit}
    return together


def by_signal(name: str, field: Field) -> dict[str, Field]:
    """A field whose columns are several signals of each joint (`knee.pos`, `knee.vel`) as one field a signal."""
    groups = _by_place(dict.fromkeys(field.labels))
    if len(groups) < 2 or sum(len(group) for group, *_ in groups) < field.width:
        return {name: field}
    at_ = {label: k for k, label in enumerate(field.labels)}
    return {
        f"{name}.{stem}": Field(field.values[:, [at_[m] for m in group.values()]], tuple(group), field.unit)
        for group, _, stem in groups
    }


def _named(stem: str, unit: str) -> str:
    return f"{stem} [{unit}]".strip() if unit else stem


def rows(
    path: Path, items: Sequence[Mapping[str, Any]], notes: list[str], spelled: dict[str, list[Any]] | None = None
) -> dict[str, F64]:
    """Records (JSON objects) as columns; nested objects get dotted names. What is no number is noted, or put into
    `spelled`."""
    flat = [flatten(item) for item in items]
    names = list(dict.fromkeys(n for row in flat[:200] for n in row))
    found = {}
    for name in names:
        values = [row.get(name) for row in flat]
        column = cells(path, name, values)
        if column is not None:
            found[name] = column
            if (odd := odd_cell(values, column)) is not None:
                notes.append(f"{path.name}: {name} has values that are no numbers, the first is {odd[0]!r}")
        elif spelled is not None:
            spelled[name] = values
    return found
