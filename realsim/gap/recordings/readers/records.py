"""Records of named values: JSON, lines (.jsonl), and what `realsim.gap.recordings.records` knows of other texts.

Those of one topic are a stream; the numbers beside a list of them (a mass, a gain) are facts of the recording.
"""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from realsim.core.errors import GapError
from realsim.core.files import check_size, read_json
from realsim.gap.recordings.recording import Reader, Recording, Stream, facts_of, first_line, no_samples
from realsim.gap.recordings.records import LEAST, Tagged, parser_of
from realsim.gap.recordings.tables import LEAST_CLOCK, rows, streams, table
from realsim.gap.recordings.vocabulary import KINDS, SIDES, english

MAX_BYTES = 512 * 2**20
MAX_LINES = 4_000_000
"""Limits of one file, for memory: an hour at 1 kHz has 3.6 million lines."""
RARE = 0.02
"""Share of the longest stream below which records of another kind are left out: greetings, settings. Set by
hand."""


def recognise(path: Path) -> bool:
    if not path.is_file():
        return False
    if path.suffix.lower() in (".json", ".jsonl", ".ndjson"):
        return first_line(path, 64).lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"[")
    return parser_of(path) is not None


def read(path: Path) -> list[Recording]:
    check_size(path, MAX_BYTES)
    notes: list[str] = []
    facts: dict[str, Any] = {}
    suffix, parser = path.suffix.lower(), parser_of(path)
    if suffix in (".jsonl", ".ndjson"):
        found: Any = [(t if isinstance(t := item.get("topic"), str) else "", item) for item in _lines(path, notes)]
    elif suffix == ".json" or parser is None:
        found = read_json(path)
    else:
        found = parser(path, notes)
        found = found if isinstance(found, Mapping) else list(found)
        found = found[0][1] if len(found) == 1 and isinstance(found, list) else found
    if suffix == ".json" or isinstance(found, Mapping):
        facts = facts_of(found) if isinstance(found, dict) else {}
        if runs := _runs(found):
            signals = {name: rows(path, _rows(run), notes) for name, run in runs.items()}
            return [
                Recording(path, f"{path.stem}_{name}", "records", (table(path, "", found),),
                          notes=tuple(notes), facts=facts)
                for name, found in signals.items()
            ]  # fmt: skip
        found = _tagged(found)
    kinds = _kinds(path, found, notes, alike=not suffix.startswith((".json", ".ndjson")))
    if not kinds:
        raise no_samples(path, "a list of objects, one a sample", notes=notes)
    made: list[Stream] = []
    for topic, part in kinds.items():
        spelled: dict[str, list[Any]] = {}
        columns = rows(path, part, notes, spelled)
        if columns:
            made += streams(path, columns, spelled, notes, topic)
    if not made:
        raise no_samples(path, "objects with numbers or lists of numbers", notes=notes)
    if any(s.clocks for s in made):
        notes += [f"{s.name} has no time: left out" for s in made if not s.clocks]
        made = [s for s in made if s.clocks]
    return [Recording(path, path.stem, "records", tuple(made), notes=tuple(notes), facts=facts)]


def _kinds(path: Path, found: Iterable[Tagged], notes: list[str], alike: bool) -> dict[str, list[Mapping[str, Any]]]:
    """Records by what they are of; `alike`: without the few that name something else than most."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for tag, item in found:
        groups.setdefault(tag, []).append(item)
    if not alike:
        return groups
    kinds: dict[tuple[str, frozenset[tuple[str, int]]], list[Mapping[str, Any]]] = {}
    total = 0
    for tag, items in groups.items():
        whole = _at_once(items)
        total += len(whole)
        layouts = [frozenset((n, len(v) if isinstance(v, list) else 0) for n, v in item.items()) for item in whole]
        counts = Counter(layouts)
        usual = [names for names in counts if counts[names] >= RARE * max(counts.values())]
        widest = [names for names in usual if not any(names < other for other in usual)]
        kind_of = {names: next(w for w in widest if names <= w) for names in usual}
        for item, names in zip(whole, layouts, strict=True):
            if names in kind_of:
                kinds.setdefault((tag, kind_of[names]), []).append(item)
    least = max(LEAST, RARE * max(map(len, kinds.values()), default=0)) if len(kinds) > 1 else 0
    kinds = {kind: items for kind, items in kinds.items() if len(items) >= least}
    if left := total - sum(map(len, kinds.values())):
        notes.append(f"{path.name}: {left} records that name something else than most are left out")
    shared = set.intersection(*(set(tag.split()) for tag, _ in kinds)) if kinds else set()
    result: dict[str, list[Mapping[str, Any]]] = {}
    for (tag, names), items in kinds.items():
        same = [t for t, n in kinds if n == names and not set(english(t)) & set(SIDES)]
        bare = any(set(words) <= {*SIDES, *KINDS} for n, _ in names if (words := english(n)))  # `pos`, not `knee_pos`
        if bare and tag in same and len(same) > 1:  # lines that begin with another word each: of a joint each
            result.setdefault("joints", []).extend({"joint": tag, **item} for item in items)
        else:
            name = " ".join(w for w in tag.split() if w not in shared)
            result[f"{name}[{len(result)}]" if name in result else name] = items
    return {"": next(iter(result.values()))} if len(result) == 1 else result


def _at_once(items: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Records of one value each, which differ in its name alone, as one for each moment (and tags) of them."""
    names = {frozenset(item) for item in items}
    same = sorted(frozenset.intersection(*names))
    if len(names) < 2 or "time" not in same or any(len(n) > len(same) + 1 for n in names):
        return items
    found: dict[str, dict[str, Any]] = {}
    for item in items:
        found.setdefault(str([item[n] for n in same]), {}).update(item)
    return list(found.values())


def _tagged(value: Any) -> list[Tagged]:
    """The longest lists of objects in a JSON value, by their names where several lie side by side."""
    return [(name, item) for name, items in _longest(value).items() for item in items]


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


def _longest(value: Any) -> dict[str, list[Mapping[str, Any]]]:
    """The longest list of objects in a JSON value, and those beside it; columns as lists are turned into rows."""
    if isinstance(value, list):
        return {"": objects} if (objects := [v for v in value if isinstance(v, Mapping)]) else {}
    if not isinstance(value, Mapping):
        return {}
    inner = {k: found for k, v in value.items() if isinstance(v, (list, Mapping)) and (found := _longest(v))}
    beside = {k: v[""] for k, v in inner.items() if isinstance(value[k], list)}
    lists = {k: v for k, v in value.items() if isinstance(v, list) and v and not isinstance(v[0], Mapping)}
    length = max((len(v) for v in lists.values()), default=0)
    same = {k: v for k, v in lists.items() if len(v) == length}
    ways = [beside, *(v for k, v in inner.items() if k not in beside)]
    if length >= 2 and len(same) >= 2:
        ways.append({"": _rows(same)})
    best = max(ways, key=lambda found: max(map(len, found.values()), default=0))
    most = max(map(len, best.values()), default=0)
    best = {k: v for k, v in best.items() if len(v) >= max(2, RARE * most)} or best
    return {"": next(iter(best.values()))} if len(best) == 1 else best


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


READER = Reader("records", "a text of records: JSON, XML elements, blocks, lines of names and numbers", recognise, read)
