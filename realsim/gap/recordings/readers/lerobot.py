"""LeRobot datasets, v2.0 to v3.0, without the lerobot package: meta/info.json and data/**/*.parquet; an episode a run.

Every file of data/ has the columns `episode_index`, `timestamp` (s), and the features of info.json; `action` is what
was commanded and `observation.state` what was measured, their columns named by the motors.
"""

from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import read_json
from realsim.core.types import F64
from realsim.gap.recordings.readers.parquet import columns_of
from realsim.gap.recordings.recording import Field, Reader, Recording, Stream, no_samples, readable, refuse_more
from realsim.gap.recordings.tables import by_signal

INDICES = ("timestamp", "episode_index", "frame_index", "index", "task_index")
MAX_EPISODES = 200


def recognise(path: Path) -> bool:
    return path.is_dir() and (path / "meta" / "info.json").is_file() and (path / "data").is_dir()


def read(path: Path) -> list[Recording]:
    info = read_json(path / "meta" / "info.json")
    features = info.get("features") if isinstance(info, dict) else None
    if not isinstance(features, dict):
        raise GapError("info.json has no features", file=path / "meta" / "info.json", expected="LeRobot v2 or v3")
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise no_samples(path, "data/**/*.parquet")
    wanted = [n for n, f in features.items() if isinstance(f, dict) and f.get("dtype") not in ("video", "image")]
    parts: dict[str, list[F64]] = {}
    size = 0
    for file in files:
        columns, _ = columns_of(file, [*wanted, *INDICES])
        for name, values in columns.items():
            parts.setdefault(name, []).append(values)
            size += values.size
        refuse_more(path, size)
    with readable(path / "data", "dataset: its files do not fit together"):
        whole = {n: np.concatenate(p) for n, p in parts.items()}
        episodes = np.unique(whole["episode_index"])
    length = len(whole["episode_index"])
    fields = {n: v.reshape(length, -1) for n, v in whole.items() if n not in INDICES and len(v) == length}
    if not fields:
        raise no_samples(path, "features of numbers: action, observation.state")
    labels = {n: _names(features[n], v.shape[1]) for n, v in fields.items()}
    skipped = {n: str(f.get("dtype")) for n, f in features.items() if isinstance(f, dict) and n not in whole}
    facts: dict[str, Any] = {str(k): info[k] for k in ("robot_type", "fps", "codebase_version") if k in info}
    notes = (f"{len(episodes)} episodes: the first {MAX_EPISODES} are read",) if len(episodes) > MAX_EPISODES else ()
    found = []
    for episode in episodes[:MAX_EPISODES]:
        rows = np.flatnonzero(whole["episode_index"] == episode)
        clock = whole["timestamp"][rows] if "timestamp" in whole else rows / float(info.get("fps", 30))
        parts_of = {m: f for n, v in fields.items() for m, f in by_signal(n, Field(v[rows], labels[n])).items()}
        stream = Stream("", "lerobot", {"timestamp": clock}, parts_of)
        found.append(Recording(path, f"episode_{int(episode):06d}", "lerobot", (stream,), skipped, notes, facts))
    if not found:
        raise no_samples(path, "episodes with rows")
    return found


def _names(feature: Any, width: int) -> tuple[str, ...]:
    """The motors' names: a list, or lists by kind (`{"motors": [...]}`, as v2 writes them)."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        names = [n for part in names.values() for n in (part if isinstance(part, list) else [part])]
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        return ()
    return tuple(names) if len(set(names)) == len(names) == width else ()


READER = Reader("lerobot", "a LeRobot dataset (meta/info.json and data/)", recognise, read)
