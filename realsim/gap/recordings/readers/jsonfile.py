"""JSON: lines of one object each (.jsonl), a list of objects, or an object that holds such a list (`entries`).

Lines that name a topic are sorted by it; the numbers beside a list (a mass, a gain) are facts of the recording.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from realsim.core.errors import GapError
from realsim.core.files import check_size, read_json
from realsim.gap.recordings.recording import Reader, Recording, Window, facts_of, first_line, no_samples, refuse_more
from realsim.gap.recordings.tables import LEAST_CLOCK, rows, table

MAX_BYTES = 512 * 2**20
MAX_LINES = 4_000_000


def recognise(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in (".json", ".jsonl", ".ndjson"):
        return False
    return first_line(path, 64).lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"[")


def read(path: Path, window: Window) -> list[Recording]:
    check_size(path, MAX_BYTES)
    notes: list[str] = []
    facts: dict[str, Any] = {}
    if path.suffix.lower() == ".json":
        value = read_json(path)
        facts = facts_of(value) if isinstance(value, dict) else {}
        if runs := _runs(value):
            signals = {name: rows(path, _rows(run), notes) for name, run in runs.items()}
            refuse_more(path, sum(v.size for found in signals.values() for v in found.values()))
            return [
                Recording(path, f"{path.stem}_{name}", "json", (table(path, "", found, window=window),),
                          notes=tuple(notes), facts=facts)
                for name, found in signals.items()
            ]  # fmt: skip
        items = _longest(value)
    else:
        items = list(_lines(path, notes))
    if not items:
        raise no_samples(path, "a list of objects, one a sample")
    streams = []
    for topic, part in _by_topic(items).items():
        columns = rows(path, part, notes)
        if columns:
            refuse_more(path, sum(v.size for v in columns.values()))
            streams.append(table(path, topic, columns, window=window))
    if not streams:
        raise no_samples(path, "objects with numbers or lists of numbers")
    return [Recording(path, path.stem, "json", tuple(streams), notes=tuple(notes), facts=facts)]


def _lines(path: Path, notes: list[str]) -> Iterator[Mapping[str, Any]]:
    broken = 0
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            if number > MAX_LINES:
                raise GapError("the file has too many lines", file=path, expected=f"at most {MAX_LINES:,}")
            if not line.strip():
                continue
            try:
                value = json.loads(line)
            except (ValueError, RecursionError) as error:
                broken += 1
                if broken > 10 and broken > 0.01 * number:
                    raise GapError("broken JSON", file=path, found=f"line {number}: {str(error)[:100]}") from error
                continue
            if isinstance(value, Mapping):
                yield value
    if broken:
        notes.append(f"{path.name}: {broken} lines that are no JSON are left out")


def _longest(value: Any) -> list[Mapping[str, Any]]:
    """The longest list of objects in a JSON value; columns as lists are turned into rows."""
    if isinstance(value, list):
        return [v for v in value if isinstance(v, Mapping)]
    if not isinstance(value, Mapping):
        return []
    inner = [found for v in value.values() if isinstance(v, (list, Mapping)) and (found := _longest(v))]
    lists = {k: v for k, v in value.items() if isinstance(v, list) and v and not isinstance(v[0], Mapping)}
    length = max((len(v) for v in lists.values()), default=0)
    same = {k: v for k, v in lists.items() if len(v) == length}
    if length >= 2 and len(same) >= 2:
        inner.append(_rows(same))
    return max(inner, key=len, default=[])


def _rows(lists: Mapping[str, list[Any]]) -> list[Mapping[str, Any]]:
    return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]


def _runs(value: Any) -> dict[str, dict[str, list[Any]]]:
    """Name -> lists of samples, of records side by side that hold the same ones each: rollouts. Nothing of other JSON.

    Records of lists as long in all, of which there are many, are samples: lists of joints.
    """
    numbered = isinstance(value, Mapping) and all(str(k)[-1:].isdigit() for k in value)
    parts: Mapping[Any, Any] = (
        dict(enumerate(value)) if isinstance(value, list) else value if isinstance(value, Mapping) else {}
    )
    if isinstance(value, list) or numbered:
        found = {str(k): _samples(v) for k, v in parts.items() if isinstance(v, Mapping)}
        lengths = {len(next(iter(f.values()))) for f in found.values() if f}
        alike = len({frozenset(f) for f in found.values()}) == 1
        if len(found) == len(parts) > 1 and lengths and alike and (len(lengths) > 1 or len(found) < LEAST_CLOCK):
            return found
    inner = parts.values() if isinstance(value, Mapping) else ()
    return next((found for v in inner if (found := _runs(v))), {})


def _samples(record: Mapping[str, Any]) -> dict[str, list[Any]]:
    """The lists of one length in a record, where these are signals."""
    lists = {k: v for k, v in record.items() if isinstance(v, list) and v and not isinstance(v[0], Mapping)}
    lengths = {len(v) for v in lists.values()}
    return lists if len(lists) > 1 and len(lengths) == 1 and min(lengths) >= LEAST_CLOCK else {}


def _by_topic(items: list[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for item in items:
        topic = item.get("topic", "")
        groups.setdefault(topic if isinstance(topic, str) else "", []).append(item)
    return groups


READER = Reader("json", "a .json or .jsonl file of objects, one a sample", recognise, read)
