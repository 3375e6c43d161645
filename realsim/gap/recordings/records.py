"""Texts that name each value, as records: a line, a block or an element of XML each.

t:20 goal:0.1,0.2 q:0.1,0.2                              what a board prints; other lines lie between
motor,joint=hip pos=0.1,vel=2 1698765432000              words before it say whose line it is
[ID:001] Goal:5 Pos:4 [ID:002] Goal:7 Pos:6              names that come again: parts of one record
RCOU, 61904000, 1467, 1514     FMT, RCOU, Time,C1,C2     lines of cells that another line names
feedBack { joints: 0.1 joints: 0.2 }                     blocks, in braces or indented, with `---` in between
<Rob><AIPos A1="0.1" A2="0.2"/></Rob>                    elements
,result,table,_time,_value,_field,joint                  annotated CSV of InfluxDB: a value a row
"""

import csv
import io
import re
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any

from realsim.core.errors import GapError, RealsimError
from realsim.core.files import read_bytes, read_head
from realsim.core.text_table import number
from realsim.gap.recordings.recording import readable

LEAST = 5
"""Records alike from which a text is one of records. Set by hand: a letter or a settings file has fewer."""
HEAD = 2**16
"""Bytes by which a text is recognised."""
MAX_BYTES = 256 * 2**20
"""Of a text that is parsed as a whole, for memory."""
MAX_DEPTH = 40
Tagged = tuple[str, Mapping[str, Any]]
"""A record and whose it is: a topic, a tag, the words before it."""
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_UNIT = r"(?:\s?(rad/s|deg/s|°/s|rad|deg|°|rpm|Nm|mm|ms|us|mA|m|s|A)(?![\w/=:]))?"
_PAIR = re.compile(
    rf"(?<!\w)(?:([^\W\d][\w./\[\]]*)\s*=\s*|([^\W\d](?:[\w./ ]|\[[\w./ ]{{0,20}}\]){{0,40}}?)\s*:\s*)(?:"
    rf"[\[(]\s*({_NUMBER}(?:(?:\s*,\s*|\s+){_NUMBER})*)\s*[\])]"
    rf"|({_NUMBER}(?:,\s?{_NUMBER}(?![\w.]))*)[iu]?{_UNIT}(?=[\s,;|\])}}]|$)"
    r"|\"([^\"]*)\"|([^\W\d][^\s,;=:|\[\](){}\"]*)(?=[\s,;|\])}]|$)(?!\s*[:=]))"
)
_BARE = re.compile(rf"(?<![\w.])(?:(?:\d{{4}}-\d\d-\d\d[T ])?\d\d:\d\d:\d\d(?:[.,]\d+)?Z?|{_NUMBER})(?![\w.])")
_MOMENT = re.compile(r".*:.*|1[0-9]{9}(?:[0-9]{3}){0,3}(?:\.\d+)?")
"""A time of day, or one since 1970 in s, ms, us or ns."""
_WORD = re.compile(r"[^\W\d][\w./-]*")
_TOKEN = re.compile(
    r"(?<![\w./])([\w./]+)\s*:?\s*\{|(\})|(?<![\w./])([\w./]+)\s*:\s*(\"[^\"]*\"|\[[^\]]*\]|[^\s{},;]+)", re.ASCII
)
_INDENTED = re.compile(r"( *)((?:- +)*|-$)(?:([^\s:#'\"\[][^:]{0,60}?) {0,3}:(?: +(.*))?|(.*))$")
_MODELS = ("mujoco", "robot", "sdf", "html", "svg", "launch")
"""Elements of documents that are no recordings."""


def parser_of(path: Path) -> Callable[[Path, list[str]], Iterable[Tagged] | dict[str, Any]] | None:
    """What reads a text of records, by its head; None for any other file."""
    try:
        data = read_head(path, HEAD)
    except RealsimError:
        return None
    if data.startswith(b"SQLite format 3\0"):
        return tables
    if b"\0" in data:
        return None
    text = data.decode("utf-8-sig", errors="replace")
    if text.startswith(("#group", "#datatype", "#default")):
        return annotated
    if text.lstrip().startswith("<"):
        tags = Counter(re.findall(r"<(\w[\w.:-]*)(?=[\s>/])", text))
        first = next(iter(tags), "")
        document = first in _MODELS and tags[first] == 1
        return elements if max(tags.values(), default=0) >= LEAST and not document else None
    lines = text.splitlines()[: -1 if len(data) == HEAD else None]
    if sum(line.rstrip() == "---" for line in lines) >= LEAST or _in_braces(lines):
        return blocks
    names_of = names_in(lines)
    found = Counter((made[0], *made[1]) for line in lines if (made := _record(line, names_of)))
    return named_lines if max(found.values(), default=0) >= LEAST else None


def named_lines(path: Path, notes: list[str]) -> Iterator[Tagged]:
    """A record a line."""
    names_of = names_in(read_head(path, HEAD).decode("utf-8-sig", errors="replace").splitlines())
    left = 0
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for line in file:
            found = _record(line, names_of)
            left += found is None and bool(line.strip())
            if found is not None:
                yield found
    if left:
        notes.append(f"{path.name}: {left} lines without names and numbers are left out")


def names_in(lines: Sequence[str]) -> Callable[[str, int], list[str]]:
    """(word that a line of cells begins with, count of its other cells) -> names of these, where one of `lines` has
    that word and ends in as many names; else nothing."""
    heads = [re.findall(r"[^\s,;:#\"]+", line) for line in lines]

    @lru_cache(maxsize=1000)
    def find(tag: str, width: int) -> list[str]:
        for head in heads if width > 1 else ():
            names = head[-width:]
            if tag in head[:-width] and len(set(names)) == width and all(number(n) is None for n in names):
                return names
        return []

    return find


def _cells(line: str) -> list[str]:
    """The cells of a line with at least two numbers among them; none of any other one."""
    cells = [c.strip().strip('"') for c in re.split(r"[,;\t]" if re.search(r"[,;\t]", line) else r"\s+", line.strip())]
    return cells if sum(number(c or "x") is not None for c in cells) >= 2 else []


def _record(line: str, names_of: Callable[[str, int], list[str]]) -> Tagged | None:
    """(words, name -> text, or list of texts) of a line that names at least one of two numbers in it."""
    if (cells := _cells(line)) and _WORD.fullmatch(cells[0]) and (listed := names_of(cells[0], len(cells) - 1)):
        return cells[0], dict(zip(listed, cells[1:], strict=True))
    pairs: list[tuple[str, Any, bool]] = []
    gaps: list[str] = []
    end = 0
    for match in _PAIR.finditer(line):
        name, other, several, one, unit, quoted, word = match.groups()
        values = re.split(r"[,\s]+", several or one or "")
        value: Any = values if several or len(values) > 1 else one or quoted or word
        name = (name or other).strip()
        pairs.append((f"{name} [{unit}]" if unit else name, value, bool(several or one)))
        gaps.append(line[end : match.start()])
        end = match.end()
    if not pairs:
        return None
    names = [n for n, *_ in pairs]
    first = next((k for k, n in enumerate(names) if names.count(n) > 1), len(names))
    outside = f"{gaps[0]} {line[end:]}"
    bare = _BARE.findall(outside)
    moment = next((text for text in bare if _MOMENT.fullmatch(text)), "")
    record: dict[str, Any] = {f"column_{k + 1}": text for k, text in enumerate(bare) if text != moment}
    record |= {"time": moment} if moment and "time" not in names else {}
    numbers = len(record) + sum(numeric for *_, numeric in pairs)
    record |= {n: v for n, v, _ in pairs[:first]}
    words = " ".join(_WORD.findall(_BARE.sub(" ", outside)))
    if first < len(names):
        parts: list[dict[str, Any]] = []
        for k in range(first, len(names)):
            if names[k] == names[first]:
                label = " ".join(re.findall(r"[^\W\d]\w*(?:\s\d+\b)?", gaps[k]))
                parts.append({"name": label} if label else {})
            parts[-1][names[k]] = pairs[k][1]
        record[""], words = parts, ""
    return (words, record) if numbers > 1 and any(numeric for *_, numeric in pairs) else None


def annotated(path: Path, notes: list[str]) -> Iterator[Tagged]:
    """A record a value, as InfluxDB and Grafana export a query: its field and tags in columns of text."""
    header: list[str] = []
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        for row in csv.reader(file):
            if "_value" in row and "_time" in row:  # each table begins with its header
                header = row
            elif row and not row[0].startswith("#"):
                cells = dict(zip(header, row, strict=False))
                tags = {n: v for n, v in cells.items() if n and n[0] != "_" and n not in ("result", "table")}
                if header and "_value" in cells:
                    record = {**tags, "time": cells["_time"], cells.get("_field", "value"): cells["_value"]}
                    yield cells.get("_measurement", ""), record


def tables(path: Path, notes: list[str]) -> Iterator[Tagged]:
    """A record a row of each table of an SQLite file."""
    with (
        readable(path, "SQLite file"),
        closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base,
    ):
        for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall():
            found = base.execute('SELECT * FROM "{}"'.format(name.replace('"', '""')))
            columns = [c[0] for c in found.description]
            for row in found:
                yield name, {n: v for n, v in zip(columns, row, strict=True) if not isinstance(v, bytes)}


def _in_braces(lines: Sequence[str]) -> bool:
    opened = Counter(m[1] for line in lines if (m := re.match(r"([\w./]+)\s*:?\s*\{", line)))
    return max(opened.values(), default=0) >= LEAST


def blocks(path: Path, notes: list[str]) -> Iterator[Tagged]:
    """A record a block: up to `---`, or to where the first name of the block comes again."""
    braces = _in_braces(read_head(path, HEAD).decode("utf-8-sig", errors="replace").splitlines())
    entries: list[tuple[float, str, str | None]] = []
    depth = 0
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for line in file:
            begun = line.rstrip() == "---"
            for level, name, value in _tokens(line, depth) if braces else _indented(line):
                depth = int(level) + (value is None)
                if name == "}":
                    depth = int(level)
                    continue
                again = level == 0 and entries and name == entries[0][1]
                begun |= bool(again and any(lv == 0 and n != name for lv, n, _ in entries))
                if begun and entries:
                    yield "", _nested(path, entries)
                    entries = []
                begun = False
                entries.append((level, name, value))
            if begun and entries:
                yield "", _nested(path, entries)
                entries, depth = [], 0
    if entries:
        yield "", _nested(path, entries)


def _tokens(line: str, depth: int) -> Iterator[tuple[float, str, str | None]]:
    """(depth, name, value or None where a block begins) of a line with braces; the end of a block is named `}`."""
    for match in _TOKEN.finditer(line):
        if match[2]:
            depth = max(depth - 1, 0)
            yield depth, "}", ""
        else:
            yield depth, match[1] or match[3], match[4]
            depth += match[4] is None


def _indented(line: str) -> Iterator[tuple[float, str, str | None]]:
    match = _INDENTED.match(line.rstrip())
    if match is None or not line.strip() or line.lstrip().startswith(("#", "---")):
        return
    indent, items, name, value, alone = match.groups()
    at = len(indent)
    if items:
        yield at + 0.5, "", None if name else alone
        at += len(items)
    if name:
        yield at, name, value or None


def _nested(path: Path, entries: Sequence[tuple[float, str, str | None]]) -> dict[str, Any]:
    root: dict[str, Any] = {}
    above: list[tuple[float, dict[str, Any]]] = [(-1.0, root)]
    for level, name, value in entries:
        while above[-1][0] >= level:
            above.pop()
        inner: Any = {} if value is None else value.strip("'\" ")
        if isinstance(inner, str) and inner.startswith("["):
            inner = [word.strip("'\" ") for word in inner.strip("[]").split(",")]
        _put(above[-1][1], name, inner)
        if value is None:
            above.append((level, inner))
        if len(above) > MAX_DEPTH:
            raise GapError("blocks within blocks without end", file=path, expected=f"at most {MAX_DEPTH} levels")
    return root


def _put(record: dict[str, Any], name: str, value: Any) -> None:
    """What comes again is a list."""
    if name not in record:
        record[name] = value
    elif isinstance(record[name], list):
        record[name].append(value)
    else:
        record[name] = [record[name], value]


def elements(path: Path, notes: list[str]) -> dict[str, Any]:
    """A document, or elements without one around them, as JSON would have them."""
    from defusedxml import ElementTree
    from defusedxml.common import DefusedXmlException

    text = re.sub(rb"<\?xml.*?\?>", b"", read_bytes(path, MAX_BYTES).removeprefix(b"\xef\xbb\xbf"))
    root: Any = None
    try:
        for _, element in ElementTree.iterparse(io.BytesIO(b"<_>%b</_>" % text), ("start",), forbid_dtd=True):
            root = element if root is None else root
    except (ElementTree.ParseError, DefusedXmlException, ValueError) as error:
        if root is None or len(root) == 0:
            raise GapError("not plain XML", file=path, expected="elements", found=str(error)[:160]) from error
        notes.append(f"{path.name}: read up to where it is damaged ({error})")
    value = _of_element(path, root, 0)
    return value if isinstance(value, dict) else {}


def _of_element(path: Path, element: Any, depth: int) -> Any:
    if depth > MAX_DEPTH:
        raise GapError("elements within elements without end", file=path, expected=f"at most {MAX_DEPTH} levels")
    record: dict[str, Any] = dict(element.attrib)
    for inner in element:
        _put(record, inner.tag.rpartition("}")[2], _of_element(path, inner, depth + 1))
    text = (element.text or "").strip()
    if not record:
        return text
    return {**record, "": text} if text else record
