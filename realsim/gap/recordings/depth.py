"""Depth frames of a recording: found while it is read, written beside the run that they belong to.

Of each frame only the time is kept at first, as a stream that knows when it was received; so its clock, jumps and the
window are treated as those of any other stream. The frames of a case are then read from the recording one by one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.bags.images import (
    IMAGES,
    INFO,
    camera_name,
    camera_of,
    depth_of,
    encoding,
    info_beside,
    is_depth,
    packed_depth,
)
from realsim.core.bags.stream import Bag, full
from realsim.core.errors import GapError, MissingExtraError, RealsimError, did_you_mean, require
from realsim.core.files import write_bytes, write_text
from realsim.core.types import F64, Intrinsics
from realsim.gap.recordings.messages import Topics
from realsim.gap.recordings.model import Target
from realsim.gap.recordings.recording import Recording, Stream
from realsim.gap.recordings.vocabulary import english

RECEIVED = "received"
"""The field of a stream of frames: (T, 1) s, by which a frame is found again."""
MOST = 120
"""Frames of a run that are written, evenly spread; the camera is told from 60 of all runs."""


def picture(kind: str) -> bool:
    """Whether messages of a type are pictures or describe their camera."""
    return full(kind) in (*IMAGES, INFO)


def is_frames(stream: Stream) -> bool:
    """Whether a stream is that of depth frames."""
    return picture(stream.type)


@dataclass(frozen=True)
class DepthTopic:
    """One topic of depth frames."""

    camera: Intrinsics
    distorts: bool
    frame: str
    """tf's frame in which they are taken."""


@dataclass
class Pictures:
    """What is seen of pictures and cameras while a recording is read."""

    encodings: dict[str, str] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)
    cameras: dict[str, tuple[Intrinsics, bool]] = field(default_factory=dict)
    damaged: dict[str, str] = field(default_factory=dict)
    """Topic that describes a camera -> why its last message could not be read."""

    def wants(self, topic: str, kind: str) -> bool:
        """Whether further messages of a topic are of use: depth, and the first description of a camera."""
        if full(kind) == INFO:
            return topic not in self.cameras
        return topic not in self.encodings or is_depth(topic, self.encodings[topic])

    def take(self, topics: Topics, topic: str, kind: str, decode: Callable[[], Any], received: float) -> None:
        """Note one message; frames go into `topics` by their time alone."""
        if full(kind) == INFO:
            try:
                self.cameras[topic] = camera_of(decode())
            except Exception as error:  # what damage leads to; the next one may be whole
                self.damaged[topic] = f"{type(error).__name__}: {error}"[:120]
        elif self.wants(topic, kind):
            topics.add(topic, kind, lambda: self._time_of(topic, decode(), received), received)

    def _time_of(self, topic: str, message: Any, received: float) -> dict[str, Any]:
        self.encodings.setdefault(topic, encoding(message))
        self.frames.setdefault(topic, str(message.header.frame_id).lstrip("/"))
        return {"header": message.header, RECEIVED: received}

    def found(self) -> dict[str, DepthTopic]:
        """Topics of depth with a description of their camera."""
        depth = {t: info_beside(t, self.cameras) for t, e in self.encodings.items() if is_depth(t, e)}
        return {t: DepthTopic(*info, self.frames[t]) for t, info in depth.items() if info is not None}


def seen(recording: Recording, pictures: Pictures) -> Recording:
    """The recording with what was seen. Frames without a description of their camera are of no use."""
    found = pictures.found()
    streams = tuple(s for s in recording.streams if not is_frames(s) or s.name in found)
    skipped = {t: why for t, why in recording.skipped.items() if t not in found and t not in pictures.cameras}
    skipped |= {t: f"cannot be decoded ({why})" for t, why in pictures.damaged.items() if t not in pictures.cameras}
    for topic in {s.name for s in recording.streams if is_frames(s)} - set(found):
        skipped[topic] = "depth without camera_info beside it"
    return replace(recording, streams=streams, skipped=skipped, depth=found)


@dataclass(frozen=True)
class Depth:
    """Whose frames go into the case."""

    topic: str
    camera: str
    """Of the model."""
    source: DepthTopic

    def as_dict(self) -> dict[str, Any]:
        """`depth_camera` of log.json."""
        lens = self.source.camera
        return {"camera": self.camera} | {k: float(getattr(lens, k)) for k in ("fx", "fy", "cx", "cy")}

    def doubts(self) -> list[str]:
        """What the case does not say of the camera, or says wrongly."""
        warnings = [f'the noise of {self.camera} is not known: depth_noise needs "noise" in depth_camera of log.json']
        if self.source.distorts:
            warnings.append(f"the lens of {self.topic} distorts: that is not undone, and looks like a wrong mount")
        return warnings


def choose(recording: Recording, target: Target, wanted: str) -> tuple[Depth | None, str]:
    """(the frames and the camera of the model that saw them, or None; what is missing).

    Args:
        wanted: `NAME` of the model's camera, `NAME=TOPIC`, `none`, or nothing where only one fits.

    Raises:
        GapError: a camera that is not in the model, a topic without depth.
    """
    kept = {s.name for s in recording.streams}
    topics: dict[str, DepthTopic] = {t: d for t, d in recording.depth.items() if t in kept}
    name, _, topic = wanted.partition("=")
    if wanted == "none" or not (topics or wanted):
        return None, ""
    known = [target.model.camera(i).name for i in range(target.model.ncam) if target.model.camera(i).name]
    if name and name not in known:
        raise GapError(
            f"the model has no camera {name!r}", file=target.path, expected=", ".join(known) or "a <camera>",
            hint=did_you_mean(name, known),
        )  # fmt: skip
    if (topic and topic not in topics) or not topics:
        raise GapError(
            f"no depth frames on {topic!r}" if topic else "no depth frames with camera_info", file=recording.path,
            expected="16UC1 or 32FC1, or compressedDepth, with its camera_info beside it",
            found=", ".join(topics) or "none",
        )  # fmt: skip
    usable = [topic] if topic else sorted(topics, key=lambda t: ("aligned" in t, len(t), t))
    seen = f"depth frames of {usable[0]} are left out"
    if len({camera_name(t) for t in usable}) > 1:
        return None, f"{seen}: there are several depth cameras; choose one: --camera NAME=TOPIC"
    if not name:
        place = english(f"{usable[0]} {topics[usable[0]].frame}")
        alike = known if len(known) == 1 else [n for n in known if set(english(n)) <= set(place)]
        if len(alike) != 1:
            has = f"which of {', '.join(known)} saw them? --camera NAME" if known else (
                "the model has no camera; add <camera/> to the body that carries it, at its optical centre"
            )  # fmt: skip
            return None, f"{seen}: {has}"
        name = alike[0]
    return Depth(usable[0], name, topics[usable[0]]), ""


def write_frames(depth: Depth, recording: Recording, times: F64, span: tuple[float, float], folder: Path) -> list[str]:
    """Write a run's frames and depth.txt (docs/footholds.md) to a folder; returns notes. Without frames, no folder.

    Args:
        times: (T,) s of the stream's frames on the recording's clock.
        span: s of the run's start and end on it.
    """
    stream = next((s for s in recording.streams if s.name == depth.topic), None)
    if stream is None:
        return [f"no depth frames on {depth.topic}"]
    inside = np.flatnonzero((times >= span[0]) & (times <= span[1]))
    _, first = np.unique(times[inside], return_index=True)
    inside = inside[first]
    picked = inside[np.unique(np.linspace(0, len(inside) - 1, min(MOST, len(inside))).round().astype(int))]
    at = {float(stream.fields[RECEIVED].values[k, 0]): float(times[k] - span[0]) for k in picked}
    try:
        require("recon", "writing depth frames")
        lines, bad = _write(depth, recording.path, at, folder)
    except MissingExtraError as error:
        return [f"depth frames are left out: {error.render()}"]
    if not lines:
        return [f"no depth frame of {depth.topic} lies in the run", *bad[:1]]
    write_text(folder / "depth.txt", "# seconds file\n" + "".join(line + "\n" for _, line in sorted(lines)))
    notes = [f"{len(lines)} of {len(inside)} depth frames of {depth.topic}, seen by {depth.camera}"]
    return notes + ([f"{len(bad)} depth frames cannot be read: {bad[0]}"] if bad else [])


def _write(
    depth: Depth, path: Path, at: dict[float, float], folder: Path
) -> tuple[list[tuple[float, str]], Sequence[str]]:
    """((s, line of depth.txt) of each frame, why others are left out)."""
    lines: list[tuple[float, str]] = []
    bad: list[str] = []
    size = (depth.source.camera.height, depth.source.camera.width)
    left = set(at)
    for _, _, message, received in Bag(path, GapError).messages(lambda topic, kind: topic == depth.topic):
        if received not in left:
            continue
        left.remove(received)
        try:
            image = depth_of(message)
            if image.shape != size:
                raise GapError("of another size than camera_info says", expected=str(size), found=str(image.shape))
        except RealsimError as error:
            bad.append(f"{error.message}, {error.found}")
            continue
        suffix, data = packed_depth(image)
        folder.mkdir(exist_ok=True)
        name = f"{len(lines):05d}{suffix}"
        write_bytes(folder / name, data)
        lines.append((at[received], f"{at[received]:.6f} {name}"))
        if not left:
            break
    return lines, bad
