"""ROS 1 bags (.bag), ROS 2 bags (a folder with metadata.yaml, or a lone .db3), MCAP of any; without ROS."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.bags import mcap_files
from realsim.core.bags.images import INFO
from realsim.core.bags.stream import Bag, full
from realsim.core.errors import GapError
from realsim.gap.recordings.depth import Pictures, picture, seen
from realsim.gap.recordings.jumps import steps_back
from realsim.gap.recordings.messages import Topics, signal_type
from realsim.gap.recordings.recording import Reader, Recording, Window, no_samples


def recognise(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.is_file() and path.suffix.lower() in (".bag", ".db3")


def read(path: Path, window: Window) -> list[Recording]:
    topics, pictures, bag = Topics(path), Pictures(), Bag(path, GapError)
    bag.opened = partial(_refuse_mixed, path, window)
    for topic, kind, decode, received in bag.encoded(lambda topic, kind: signal_type(kind) or picture(kind)):
        inside = window.holds(received - bag.start)
        if not picture(kind):
            if inside:
                topics.add(topic, kind, decode, received)
        elif pictures.wants(topic, kind) and (inside or full(kind) == INFO):
            pictures.take(topics, topic, kind, decode, received)
    skipped = {t: f"{kind or 'no type'}: holds no signals" for t, kind in bag.topics.items() if not signal_type(kind)}
    skipped |= bag.failures
    streams = topics.streams()
    notes = [*bag.notes, *(f"{topic}: {what}" for topic, what in topics.failures().items())]
    if not streams:
        what = "topics with joint states, commands, an IMU or a pose"
        raise no_samples(path, what, skipped | topics.failures(), window, notes)
    reader = "mcap" if mcap_files(path) else "rosbag"
    return [seen(Recording(path, path.stem, reader, streams, skipped, tuple(notes)), pictures)]


def _refuse_mixed(path: Path, window: Window, bag: Any) -> None:
    """A bag is read in the order of reception: where that clock stepped back, what came before and after is mixed.

    Raises:
        GapError: it did in the window; says what can be read.
    """
    first = 1e-9 * bag.start_time
    for clock in _as_written(path, bag):
        time = 1e-9 * clock - first
        for k in steps_back(time):
            low, high = max(time[k:].min(), time[:k].min()), min(time[:k].max(), time[k:].max())
            if low < high and window.start < high and low < window.start + window.seconds:
                before, after = f"--seconds {low:.3f}", f"--skip {high:.3f}"
                raise GapError(
                    f"the clock of reception steps back by {time[k - 1] - time[k]:.3g} s", file=path,
                    expected="messages that can be put in order by it", found=f"times from {low:.3f} to {high:.3f} s "
                    "after the first message come twice",
                    hint=f"read what lies before, with {before}, or after, with {after}; record as MCAP, which "
                    "keeps the order",
                )  # fmt: skip


def _as_written(path: Path, bag: Any) -> Iterator[Any]:
    """(T,) ns of reception of the messages of each topic, in the order in which they were written."""
    for reader in bag.readers:
        for index in getattr(reader, "indexes", {}).values():  # a ROS 1 bag's
            yield np.array([e.time for e in sorted(index, key=lambda e: (e.chunk_pos, e.offset))], dtype=float)
    for file in sorted(path.glob("*.db3")) if path.is_dir() else [path] if path.suffix.lower() == ".db3" else []:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as database:
            rows = np.array(database.execute("SELECT topic_id, timestamp FROM messages ORDER BY id").fetchall())
        for topic in np.unique(rows[:, 0]) if len(rows) else ():
            yield rows[rows[:, 0] == topic, 1].astype(float)


MCAP = Reader(
    "mcap",
    "a .mcap file with ROS 1, ROS 2, Protobuf or JSON messages, or the folder of a bag of them",
    lambda path: bool(mcap_files(path)),
    read,
    cuts=True,
)
ROSBAG = Reader("rosbag", "a .bag file, a .db3 file, or a ROS 2 bag's folder (metadata.yaml)", recognise, read, True)
