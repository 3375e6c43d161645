"""Tables of text: `,` `;` tab or blanks between cells; cells may be empty, text, lists (`[0.1, 0.2]`) or times of day.

Lines before the header, a line of units below it, and a header that is missing are recognised by where the numbers
begin.
"""

import csv
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import date
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import check_size
from realsim.core.types import F64

MAX_BYTES = 2 * 2**30
"""A budget: larger files are refused before they are read."""
MAX_WIDTH = 256
"""Items of one cell; beyond, it is a picture, a cloud or a map."""
BLOCK = 50_000
"""Rows that are text at the same time."""
PREAMBLE = 60
"""Lines in which the numbers must begin."""
ENCODINGS = ("utf-8-sig", "cp1252")
"""In the order in which they are tried; cp1252 is what spreadsheets on Windows write,
in China gb18030, in Japan cp932."""
CHINESE, JAPANESE = "gb18030", "cp932"
EMPTY = ("", "nan", "null", "none", "na", "n/a", "-")
"""How a cell says that there is no number."""
_BLANKS = re.compile(r"(?:^#)?[ ]+")
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_DURATION = re.compile(r"([-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?) (sec|s|ms|min|hr)")
"""As MATLAB writes the times of a timetable."""
_STAMPED = re.compile(r"^(\d\d:\d\d:\d\d\.\d+) -> (?=\S*(\t|,|;| ))")
"""As Arduino's serial monitor puts the time before a line."""
FEW = 0.02
"""Share of the rows that may have another number of cells: what a program prints in between, lines cut on a serial
port. Set by hand: two such logs have 0.1 and 0.2 %, tables with unquoted lists or decimal commas nearly all."""
_END_OF_HEADER = re.compile("end[_ ]*(of[_ ]*)?header", re.IGNORECASE)
_SECONDS = {"sec": 1.0, "s": 1.0, "ms": 1e-3, "min": 60.0, "hr": 3600.0}
_MOMENT = re.compile(r"(?:(\d{4}-\d\d-\d\d)[T ])?(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)(?:Z|[+-]\d\d:?\d\d)?")


@dataclass
class TextTable:
    """The numbers of a file of text."""

    path: Path
    header: bool = True
    """Whether the file names its columns; else they are called column_1, column_2, ..."""
    parts: dict[str, list[F64]] = field(default_factory=dict)
    """Column -> its numbers, (T,) or of lists (T, K), in blocks of rows; a missing one is NaN."""
    text: list[str] = field(default_factory=list)
    """Columns that hold none."""
    words: dict[str, list[str]] = field(default_factory=dict)
    """Column of text of which at most MAX_WIDTH cells differ, as names do -> its cells."""
    odd: dict[str, tuple[str, int]] = field(default_factory=dict)
    """Column of numbers -> its first cell that is neither a number nor empty, and the row of that."""
    notes: list[str] = field(default_factory=list)

    @property
    def columns(self) -> dict[str, F64]:
        """Column -> its numbers; empty without a row."""
        return {n: np.concatenate(p) for n, p in self.parts.items() if p}

    def take(self, block: Sequence[tuple[int, list[str]]]) -> int:
        """Add rows with their numbers; returns how many numbers they held."""
        size = 0
        for i, name in enumerate(self.parts):
            if not name:  # a table's index
                continue
            cells_of, before = [row[i] for _, row in block], self.parts[name]
            if name in self.text:
                self._spell(name, cells_of)
                continue
            if all(not cell.strip() for cell in cells_of):
                column: F64 | None = np.full((len(block), *(before[0].shape[1:] if before else ())), np.nan)
            else:
                column = cells(self.path, name, cells_of, [number for number, _ in block])
            if column is None or (before and column.ndim != before[0].ndim):
                self.text.append(name)
                if not before:
                    self.words[name] = []
                    self._spell(name, cells_of)
                self.parts[name] = []
                self.odd.pop(name, None)
                continue
            if name not in self.odd and (found := odd_cell(cells_of, column)) is not None:
                self.odd[name] = found[0], block[found[1]][0]
            before.append(column)
            size += column.size
        return size

    def _spell(self, name: str, found: Sequence[str]) -> None:
        if name in self.words:
            self.words[name] += [sys.intern(cell.strip()) for cell in found]
            if len(set(self.words[name])) > MAX_WIDTH:
                del self.words[name]


def read_text_table(
    path: Path,
    unit: Callable[[str], str] = lambda cell: "",
    grown: Callable[[int], None] = lambda size: None,
    odd: float = 0.0,
) -> TextTable:
    """The columns of numbers of a file.

    Args:
        unit: what a cell of a line of units says, or nothing; columns are then called `name [unit]`.
        grown: called with the count of numbers read so far; may raise.
        odd: share of rows of another width that may be left out, with a note.

    Raises:
        GapError: not text, a header that names a column twice, a row or cell that does not end where it should.
    """
    check_size(path, MAX_BYTES)
    for encoding in ENCODINGS:
        try:
            with path.open(encoding=_encoding(path) or encoding, newline="", errors="strict") as file:
                return _read(path, file, unit, grown, odd)
        except UnicodeError as error:
            if encoding == ENCODINGS[-1] or b"\0" in path.open("rb").read(4096):
                raise GapError("not a text file", file=path, expected="UTF-8 text", found=str(error)) from error
    raise AssertionError


def first_lines(path: Path) -> list[str]:
    """The first lines of a text file; none of a binary one."""
    with path.open("rb") as file:
        data = file.read(65536)
    marked = _encoding(path)
    if not marked and b"\0" in data:
        return []
    lines = data.decode(marked or "cp1252", errors="replace").splitlines()[:PREAMBLE]
    return [_STAMPED.sub(r"\1\2", line) for line in lines]


def begin(lines: Sequence[str]) -> tuple[str, int]:
    """(what parts the cells, the first line of numbers); the number of lines where none is."""
    marks = [k for k, line in enumerate(lines) if _END_OF_HEADER.search(line)]
    if marks:
        delimiter, first = begin(lines[marks[-1] + 1 :])
        return delimiter, marks[-1] + 1 + first
    found = []
    for k, line in enumerate(lines):
        for delimiter in (*sorted(",;\t", key=line.count, reverse=True), " "):
            if _is_numbers(line, delimiter):
                found.append((delimiter, k))
                break
    if not found:
        return max(",;\t", key=lines[0].count) if lines else ",", len(lines)
    # Rows are the lines of the commonest shape, without a word before them where most have none, below a header.
    shapes = [(delimiter, len(_split(lines[k], delimiter))) for delimiter, k in found]
    (delimiter, width), _ = Counter(shapes).most_common(1)[0]
    rows = [k for (_, k), shape in zip(found, shapes, strict=True) if shape == (delimiter, width)]
    bare = [k for k in rows if number(_split(lines[k], delimiter)[0].strip() or "nan") is not None]
    rows = bare if 2 * len(bare) >= len(rows) else rows
    numbers = {k for _, k in found}
    above = dict(pairwise(k for k, line in reversed([*enumerate(lines)]) if line.strip()))
    heads = {k for k, b in above.items() if b not in numbers and len(_split(lines[b], delimiter)) == width}
    return delimiter, next((k for k in rows if k in heads), rows[0])


def _is_numbers(line: str, delimiter: str) -> bool:
    filled = [c for c in _split(line, delimiter) if c.strip()]
    return len(filled) > 1 and sum(_cell(c) is not None for c in filled) >= max(2, 0.5 * len(filled))


def cells(path: Path, name: str, values: Sequence[Any], numbers: Sequence[int] = ()) -> F64 | None:
    """A column of any cells as numbers: (T,) of numbers, (T, K) of lists (also written as text); None for text.

    Args:
        numbers: of the rows; counted from 1 if none are given.

    Raises:
        GapError: lists of different lengths.
    """
    rows = [_cell(v) for v in values]
    wide = next((len(r) for r in rows if isinstance(r, list)), 0)
    if wide:
        odd = next((i for i, r in enumerate(rows) if isinstance(r, list) and len(r) != wide), None)
        if odd is not None:
            raise GapError(
                f"the lists in column {name!r} have different lengths", file=path, expected=f"{wide} numbers",
                found=f"{len(rows[odd])} in row {numbers[odd] if numbers else odd + 1}",  # type: ignore[arg-type]
            )  # fmt: skip
        if wide > MAX_WIDTH:
            return None
        blank = [np.nan] * wide
        return np.array([r if isinstance(r, list) else blank for r in rows], dtype=np.float64)
    known = sum(r is not None for r in rows)
    if known == 0 or known < sum(r is None and not _empty(v) for r, v in zip(rows, values, strict=True)):
        return None
    return np.array([np.nan if r is None else r for r in rows], dtype=np.float64)


def odd_cell(values: Sequence[Any], column: F64) -> tuple[str, int] | None:
    """The first cell that is neither a number nor empty, and its place; None without one. `column`: of `cells`."""
    for k in np.flatnonzero(np.isnan(column.reshape(len(column), -1)).all(axis=1)).tolist():
        if not _empty(values[k]):
            return str(values[k]).strip()[:40], k
    return None


def _empty(value: Any) -> bool:
    return value is None or str(value).strip().strip("[]() ").split(",")[0].strip().lower() in EMPTY


def _encoding(path: Path) -> str:
    """UTF-16 by its mark, as Excel writes it; GB 18030 and Shift JIS by their pairs of bytes; else nothing."""
    with path.open("rb") as file:
        data = file.read(65536)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    return CHINESE if _is_chinese(data) else JAPANESE if _is_japanese(data) else ""


def _is_chinese(data: bytes) -> bool:
    """Whether text is in GB 18030: all bytes beyond ASCII in pairs, nearly all of them of frequent characters.

    Letters with accents in cp1252 stand alone, or their pairs (`öß`) are of rare characters.
    """
    runs = [run for line in data.splitlines()[:PREAMBLE] for run in re.findall(rb"[\x80-\xff]+", line)]
    pairs = [run[k : k + 2] for run in runs for k in range(0, len(run), 2)]
    if not pairs or any(len(pair) < 2 for pair in pairs):
        return False
    try:
        data[: data.rfind(b"\n") + 1].decode("utf-8")
    except UnicodeDecodeError:
        frequent = [pair for pair in pairs if 0xB0 <= pair[0] <= 0xD7 and pair[1] >= 0xA1]
        return len(set(frequent)) > 1 and len(frequent) >= 0.8 * len(pairs)
    return False


def _is_japanese(data: bytes) -> bool:
    """Whether text is in Shift JIS: nearly all of its pairs are kana or frequent characters, which begin with bytes
    that are rare signs in cp1252."""
    whole = data[: data.rfind(b"\n") + 1]
    try:
        whole.decode("utf-8")
    except UnicodeDecodeError:
        try:
            found = [c for c in whole.decode(JAPANESE) if ord(c) > 127]
        except UnicodeDecodeError:
            return False
        frequent = [c for c in found if len(b := c.encode(JAPANESE)) == 2 and 0x81 <= b[0] <= 0x97]
        return len(frequent) > 1 and len(frequent) >= 0.8 * len(found)
    return False


def _split(line: str, delimiter: str) -> list[str]:
    return next(csv.reader([_BLANKS.sub(" ", line.strip()) if delimiter == " " else line], delimiter=delimiter), [])


def _read(
    path: Path, lines: Iterator[str], unit: Callable[[str], str], grown: Callable[[int], None], most_odd: float
) -> TextTable:
    """In blocks of rows, so that no more than one block is text."""
    lines = (_STAMPED.sub(r"\1\2", line) for line in lines)
    head = [line for _, line in zip(range(PREAMBLE), lines, strict=False)]
    delimiter, first = begin(head)
    first = 1 if first == len(head) else first
    lines = chain(head[first:], lines)
    if delimiter == " ":
        lines = (_BLANKS.sub(" ", line.strip()) for line in lines)
    width = len(_split(head[first], delimiter)) if first < len(head) else 0
    header = _header(path, head[:first], delimiter, width, unit, head[first:])
    found = TextTable(path, header is not None)
    if header is None:
        header = [f"column_{k + 1}" for k in range(width)]
        found.notes.append(f"there is no header: the columns are called column_1 to column_{width}")
    found.parts = {name: [] for name in header}
    block: list[tuple[int, list[str]]] = []
    odd: list[tuple[int, int]] = []
    size = number = 0
    for number, row in _rows(path, lines, delimiter, first):
        if not row or row == [""]:
            continue
        if len(row) != len(header):
            odd.append((number, len(row)))
            continue
        block.append((number, row))
        if len(block) == BLOCK:
            size += found.take(block)
            grown(size)
            block = []
    if block:
        grown(size + found.take(block))
    if odd and odd[-1][0] == number and odd[-1][1] < len(header):
        odd.pop()
        found.notes.append(f"{path.name}: the last row is cut off: it is left out")
    if odd and len(odd) > most_odd * (number - first):
        raise GapError(
            "a row has the wrong number of cells", file=path, expected=f"{len(header)}, as in the header",
            found=f"{odd[0][1]} in row {odd[0][0]}, and {len(odd) - 1} more such rows",
            hint="put lists in quotation marks; write decimal points where commas part the cells",
        )  # fmt: skip
    if odd:
        found.notes.append(f"{path.name}: {len(odd)} rows of another width are left out, the first is row {odd[0][0]}")
    return found


def _rows(path: Path, lines: Iterator[str], delimiter: str, above: int) -> Iterator[tuple[int, list[str]]]:
    """(number, cells) of each row below those `above`."""
    reader, number = csv.reader(lines, delimiter=delimiter), above
    try:
        for row in reader:
            if above + reader.line_num > number + 1:  # an open quotation mark turns all up to the next into one cell
                raise csv.Error("the cell continues in the next row")
            number += 1
            yield number, row
    except csv.Error as error:
        raise GapError(
            "a cell does not end in its row", file=path, expected="each quotation mark closed in its own row",
            found=f"{error}, from row {number + 1} on",
        ) from error  # fmt: skip


def _header(
    path: Path, above: Sequence[str], delimiter: str, width: int, unit: Callable[[str], str], body: Sequence[str]
) -> list[str] | None:
    """Names of the columns from the lines above the numbers of as many cells: the last, with a line of units; of
    several levels (`q,q,tau` above `hip,knee,hip`) all that it takes to tell the columns apart."""
    rows = [_split(line.lstrip("# "), delimiter) for line in above]
    below = [row for line in body if len(row := _split(line, delimiter)) == width]
    if below and all(line.lstrip().startswith('"') for line in body if line.strip()):  # R names the rows too
        rows = [["", *row] if len(row) == width - 1 else row for row in rows]
    elif below and not any(row[-1].strip() for row in below):  # each row ends in what parts cells
        rows = [[*row, ""] if len(row) == width - 1 else row for row in rows]
    # LabVIEW heads a last column of comments, which most rows do not have.
    rows = [row[:-1] if len(row) == width + 1 and row[-1].strip().lower() in ("", "comment") else row for row in rows]
    rows = [[c.strip() for c in row] for row in rows if len(row) == width or not width]
    kinds = [{c.partition(":")[0].lower() if ":" in c else "" for c in row if c} for row in rows]
    # `Unit: deg` under each name, as MATLAB's Simulation Data Inspector exports them, beside such rows of other facts
    facts = [len(found) == 1 and "" not in found and k > 0 for k, found in enumerate(kinds)]
    rows = [
        [c.partition(":")[2].strip() for c in row] if fact else row
        for row, found, fact in zip(rows, kinds, facts, strict=True)
        if not fact or found & {"unit", "units"}
    ]
    if not rows:
        return None
    starts = {tuple(k for k, c in enumerate(row) if c == row[0]) for row in rows}
    if len(rows) > 2 and len(starts) == 1 and 1 < len(clocks := next(iter(starts))) <= width / 2:
        return _channels(rows, clocks, unit)
    header = rows.pop()
    units = [unit(c.strip("[]()")) for c in header]
    known = [bool(u) for u, c in zip(units, header, strict=True) if c and c not in ("-", "[-]")]
    if rows and (
        all(known) or (len(set(rows[-1])) == width and sum(known) >= 0.5 * len(known) and not _differ(header))
    ):
        header = [f"{name} [{u}]" if u else name for name, u in zip(rows.pop(), units, strict=True)]
    while rows and not _differ(header):
        above_it = rows.pop()
        header = [" ".join(filter(None, pair)) for pair in zip(above_it, header, strict=True)]
    twice = sorted({h for h in header if h and header.count(h) > 1})
    if twice:
        raise GapError("the header names a column twice", file=path, found=", ".join(twice)[:200],
                       hint="give each column a name of its own in the first line")  # fmt: skip
    return header


def _channels(rows: Sequence[Sequence[str]], clocks: Sequence[int], unit: Callable[[str], str]) -> list[str] | None:
    """TwinCAT: lines `Name,a,b,Name,c` and of other facts above t,a,b,t,c; (2) marks a name that is there twice."""
    facts = {row[0].lower(): [c for k, c in enumerate(row) if k not in clocks] for row in rows}
    names = [f for f in facts.values() if number(f[0]) is None and _differ([re.sub(r" \(\d+\)$", "", c) for c in f])]
    if not names:
        return None
    units = [unit(u.partition(" (")[0]) for u in facts.get("unit", names[0])]
    left = iter(f"{n} [{u}]" if u else n for n, u in zip(names[0], units, strict=True))
    header = ["" if k in clocks else next(left) for k in range(len(rows[0]))]
    return [n or f"{header[k + 1]} time" for k, n in enumerate(header)]


def _differ(names: Sequence[str]) -> bool:
    """Whether they can be names of columns: all differ, and at most one, a table's index, is empty."""
    return len(set(names)) == len(names)


def number(text: str) -> float | None:
    """A number as written, also with a decimal comma; a date and time, or a time of day, as s; None for other text."""
    try:
        return float(text)
    except ValueError:
        pass
    if _DECIMAL_COMMA.fullmatch(text):
        return float(text.replace(",", "."))
    if moment := _MOMENT.fullmatch(text):
        day, hours, minutes, seconds = moment.groups()
        try:
            since = 86400.0 * date.fromisoformat(day).toordinal() if day else 0.0
        except ValueError:  # a thirteenth month
            return None
        return since + 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds.replace(",", "."))
    if duration := _DURATION.fullmatch(text):
        return float(duration[1].replace(",", ".")) * _SECONDS[duration[2]]
    return {"true": 1.0, "false": 0.0, "nan": np.nan}.get(text.lower())


def _cell(value: Any) -> float | list[float] | None:
    """A number, a list of numbers, or None for what is neither (a text, an empty cell)."""
    if isinstance(value, str):
        text = value.strip()
        if not text.startswith(("[", "(")):
            return number(text)
        inner = text.strip("[]() ")
        value = inner.replace(";", ",").split(",") if "," in inner or ";" in inner else inner.split()
    if isinstance(value, (bool, int, float, np.number)):
        try:
            return float(value)
        except OverflowError:  # a whole number of hundreds of digits
            return None
    if isinstance(value, (list, tuple, np.ndarray)):
        try:
            return [float(v) if v is not None else np.nan for v in np.ravel(np.asarray(value, dtype=object))]
        except (TypeError, ValueError, OverflowError):
            return None
    return None
