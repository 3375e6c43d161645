"""ROS 1 bags (.bag) and ROS 2 bags (a folder with metadata.yaml, or a lone .db3), without ROS."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.bags.definitions import register
from realsim.core.bags.images import INFO, encoding, is_depth
from realsim.core.bags.stream import full
from realsim.core.errors import GapError, extra
from realsim.gap.recordings.depth import Pictures, picture, seen
from realsim.gap.recordings.jumps import steps_back
from realsim.gap.recordings.messages import Topics, signal_type
from realsim.gap.recordings.recording import Reader, Recording, Window, no_samples


def recognise(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.is_file() and path.suffix.lower() in (".bag", ".db3")


def read(path: Path, window: Window) -> list[Recording]:
    highlevel = extra("rosbags.highlevel", "logs", "reading ROS bags")
    typesys = extra("rosbags.typesys", "logs", "reading ROS bags")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if path.suffix == ".bag" else typesys.Stores.LATEST)
    register(store, typesys.get_types_from_msg)
    topics = Topics(path)
    skipped: dict[str, str] = {}
    notes: list[str] = []
    pictures = Pictures()
    try:
        with highlevel.AnyReader([path], default_typestore=store) as bag:
            wanted = []
            for connection in bag.connections:
                if picture(connection.msgtype) and connection.msgtype in bag.typestore.fielddefs:
                    skipped[connection.topic] = f"{connection.msgtype}: holds no signals"
                    if _is_of_use(bag, connection):
                        wanted.append(connection)
                elif not signal_type(connection.msgtype):
                    skipped[connection.topic] = f"{connection.msgtype}: holds no signals"
                elif connection.msgtype not in bag.typestore.fielddefs:
                    skipped[connection.topic] = f"{connection.msgtype}: its definition is not in the bag"
                else:
                    wanted.append(connection)
            first = 1e-9 * bag.start_time
            _refuse_mixed(path, bag, first, window)
            if wanted:
                _messages(bag, wanted, first, window, topics, pictures, notes)
    except GapError:
        raise
    except Exception as error:  # rosbags, sqlite and YAML each have their own; all mean a bag that cannot be read
        raise GapError(
            "not a readable ROS bag",
            file=path,
            expected=".bag, or a folder with metadata.yaml and its .db3 or .mcap",
            found=f"{type(error).__name__}: {error}"[:200],
            hint="of a bag that was cut off: `rosbag reindex` (ROS 1) or `ros2 bag reindex`",
        ) from error
    streams = topics.streams()
    notes += [f"{topic}: {what}" for topic, what in topics.failures().items()]
    if not streams:
        raise no_samples(
            path, "topics with joint states, commands, an IMU or a pose", skipped | topics.failures(), window, notes
        )
    return [seen(Recording(path, path.stem, "rosbag", streams, skipped, tuple(notes)), pictures)]


def _is_of_use(bag: Any, connection: Any) -> bool:
    """Whether a topic of pictures is depth, by the first message that can be read, or describes a camera."""
    if full(connection.msgtype) == INFO:
        return True
    for _, _, data in bag.messages(connections=[connection]):
        try:
            return is_depth(connection.topic, encoding(bag.deserialize(data, connection.msgtype)))
        except (
            Exception
        ):  # what damage leads to; the next one may be whole, and if none is, the topic is listed as unused
            continue
    return False


def _messages(
    bag: Any, wanted: Any, first: float, window: Window, topics: Topics, pictures: Pictures, notes: list[str]
) -> None:
    try:
        for connection, received, data in bag.messages(connections=wanted):
            since = 1e-9 * received - first
            if picture(connection.msgtype):
                if window.holds(since) or full(connection.msgtype) == INFO:
                    decode = _call(bag, connection, data)
                    pictures.take(topics, connection.topic, connection.msgtype, decode, 1e-9 * received)
            elif window.holds(since):
                topics.add(connection.topic, connection.msgtype, _call(bag, connection, data), 1e-9 * received)
    except GapError:
        raise
    except Exception as error:  # damage in the middle: what came before it is good
        if not topics.streams():
            raise
        notes.append(f"{bag.paths[0].name} is damaged: read as far as it goes ({type(error).__name__}: {error})"[:200])


def _refuse_mixed(path: Path, bag: Any, first: float, window: Window) -> None:
    """A bag is read in the order of reception: where that clock stepped back, what came before and after is mixed.

    Raises:
        GapError: it did in the window; says what can be read.
    """
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


def _call(bag: Any, connection: Any, data: bytes) -> Callable[[], Any]:
    return lambda: bag.deserialize(data, connection.msgtype)


READER = Reader("rosbag", "a .bag file, a .db3 file, or a ROS 2 bag's folder (metadata.yaml)", recognise, read)
