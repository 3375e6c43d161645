"""Annotated CSV, as InfluxDB and Grafana export a query: a row a value, its field and tags in columns of text."""

import csv
from pathlib import Path

from realsim.core.text_table import first_lines, number
from realsim.gap.recordings.recording import Reader, Recording, Window, no_samples, refuse_more
from realsim.gap.recordings.tables import by_topic, on_one_clock

ANNOTATIONS = ("#group", "#datatype", "#default")
_OWN = {"", "result", "table", "_start", "_stop", "_time", "_value"}


def recognise(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() == ".csv" and "".join(first_lines(path)[:1]).startswith(ANNOTATIONS)


def read(path: Path, window: Window) -> list[Recording]:
    found: dict[tuple[str, ...], tuple[list[float], list[float]]] = {}
    header: list[str] = []
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        for count, row in enumerate(csv.reader(file)):
            refuse_more(path, count)
            if not row or row[0].startswith("#"):
                continue
            if "_value" in row and "_time" in row:  # each table begins with its header
                header = row
                continue
            cells = dict(zip(header, row, strict=False))
            time, value = number(cells.get("_time", "")), number(cells.get("_value", ""))
            if time is not None and value is not None:
                series = found.setdefault(tuple(v for n, v in cells.items() if n not in _OWN), ([], []))
                series[0].append(time)
                series[1].append(value)
    if not found:
        raise no_samples(path, "rows with _time, _value and _field")
    shared = set.intersection(*map(set, found)) if len(found) > 1 else set()
    signals = {" ".join(w for w in key if w not in shared): series for key, series in found.items()}
    return [Recording(path, path.stem, "influx", by_topic(path, on_one_clock(signals), window))]


READER = Reader("influx", "an annotated .csv of InfluxDB", recognise, read)
