"""PX4's ULog: every message of the log by its name; time stamps in us since the autopilot's start."""

from pathlib import Path

import numpy as np

from realsim.core.errors import extra
from realsim.core.files import check_size
from realsim.gap.recordings.recording import Reader, Recording, Stream, first_line, no_samples, readable
from realsim.gap.recordings.tables import grouped

MAX_BYTES = 2**30
MAGIC = b"ULog\x01\x12\x35"
HEAD = 16
"""Bytes before the first message: the magic, the version, the time of the start."""


def recognise(path: Path) -> bool:
    return path.is_file() and (path.suffix.lower() == ".ulg" or first_line(path, 8).startswith(MAGIC))


def read(path: Path) -> list[Recording]:
    pyulog = extra("pyulog", "logs", "reading .ulg")
    check_size(path, MAX_BYTES)
    with readable(path, "ULog file"):
        log = pyulog.ULog(str(path))
    streams = []
    for entry in log.data_list:
        stamps = np.asarray(entry.data["timestamp"], dtype=np.float64) * 1e-6
        arrays = {n: np.asarray(v) for n, v in entry.data.items() if n != "timestamp"}
        columns = {n: v.astype(np.float64) for n, v in arrays.items() if v.dtype.kind in "fiub"}
        if len(stamps) and columns:
            clocks = {"header": stamps}  # the autopilot stamps when it samples; nothing is received
            name = entry.name + (f"[{entry.multi_id}]" if entry.multi_id else "")
            streams.append(Stream(name, entry.name, clocks, grouped(columns)))
    if not streams:
        raise no_samples(path, "logged messages")
    notes: tuple[str, ...] = (f"{len(log.dropouts)} dropouts in the log",) if log.dropouts else ()
    if log.file_corruption or not _whole(path):
        notes += (f"{path.name} is damaged: read as far as it goes",)
    return [Recording(path, path.stem, "ulog", tuple(streams), notes=notes)]


def _whole(path: Path) -> bool:
    """Whether the last message ends where the file does; the library stops at a cut without a word."""
    with path.open("rb") as file:
        end, at = path.stat().st_size, HEAD
        while at < end:
            file.seek(at)
            at += 3 + int.from_bytes(file.read(3)[:2], "little")
    return at == end


READER = Reader("ulog", "a PX4 .ulg file", recognise, read)
