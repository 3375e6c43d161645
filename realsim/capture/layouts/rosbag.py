"""A ROS 1 or ROS 2 bag, or MCAP, with a depth camera: images, camera_info and tf (docs/captures.md).

Frames are requested in any order and a bag is read from its start, so it is unpacked once into the user's cache
folder; a changed recording is unpacked anew. Only one message is in memory at a time.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from realsim.capture.assemble import View, capture, depth_unit, frames_with
from realsim.capture.association import associate
from realsim.capture.config import CaptureConfig
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import Pair, single_file
from realsim.capture.transforms import Tree, matrix
from realsim.core.bags.images import (
    COLORS,
    IMAGES,
    INFO,
    camera_name,
    camera_of,
    color_of,
    depth_of,
    encoding,
    info_beside,
    is_depth,
    packed_depth,
    seen_from,
)
from realsim.core.bags.stream import Bag, stamp_of
from realsim.core.cache import default_folder
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.files import digest, output_folder, read_head, read_json, to_json, write_bytes, write_text
from realsim.core.types import F64, Dropped, FrameSet, Intrinsics

SUFFIXES = (".mcap", ".db3", ".bag")
TF, ODOMETRY = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
OLD_TF = "tf/msg/tfMessage"
JUMP = 0.5
"""s by which a header's clock steps against the receiver's before it is not believed."""
AHEAD = 64 * 2**10


def recognise(path: Path) -> Recognition:
    source = source_of(path)
    if source is None or (source.suffix.lower() == ".bag" and not _is_ros(source)):
        return Recognition()
    return Recognition((source.name,), (), score=45)


def source_of(path: Path) -> Path | None:
    """The bag: a folder with metadata.yaml, or a single file."""
    if path.is_dir() and (path / "metadata.yaml").is_file():
        return path if any(path.glob("*.db3")) or any(path.glob("*.mcap")) else None
    return single_file(path, SUFFIXES)


def _is_ros(path: Path) -> bool:
    """Whether a .bag is ROS 1's and no recording of a RealSense camera, which is a bag with topics of its own: they
    stand in the first chunk, or, if that is compressed, in the index at the end."""
    try:
        first = read_head(path, AHEAD)
        last = read_head(path, AHEAD, max(path.stat().st_size - AHEAD, 0))
    except (RealsimError, OSError, RuntimeError):
        return False
    return first.startswith(b"#ROSBAG") and b"/device_0/" not in first + last


def read(path: Path, config: CaptureConfig) -> FrameSet:
    source = source_of(path)
    if source is None:
        raise CaptureError("no bag", file=path, expected="a .bag, .db3 or .mcap file, or a ROS 2 bag's folder")
    folder = unpacked(source, config)
    recorded = read_json(folder / "frames.json")
    of_depth = Intrinsics(**recorded["depth_camera"])
    of_color = Intrinsics(**recorded["color_camera"]) if recorded["color_camera"] else None
    unit = depth_unit(0.001, "16UC1 is millimetres in ROS", config)
    rows = {row["name"]: row for row in recorded["frames"]}
    pairs = [
        Pair(name, folder / row["color"] if row["color"] else None, folder / row["depth"]) for name, row in rows.items()
    ]
    given = not config.ignore_poses and any(row["pose"] for row in rows.values())
    dropped = tuple(Dropped(name, reason) for name, reason in recorded["dropped"])
    if given:
        dropped += tuple(Dropped(n, "tf has no pose at its time") for n, row in rows.items() if not row["pose"])
        pairs = [p for p in pairs if rows[p.name]["pose"]]

    def view_of(pair: Pair) -> View:
        row = rows[pair.name]
        pose = np.array(row["pose"]).reshape(4, 4) if given else None
        return View(of_depth, of_color, pose, float(row["time"]))

    frames, lost = frames_with(pairs, unit, view_of, with_color=of_color is not None or recorded["colored"])
    notes = [f"the recording was unpacked into {folder}", unit.note, *recorded["notes"]]
    up = np.array([0.0, 0.0, 1.0]) if given and not config.ignore_poses else None
    return capture(path, LAYOUT.name, frames, dropped + lost, notes, recorded["warnings"], up)


def unpacked(source: Path, config: CaptureConfig) -> Path:
    """The folder with the bag's frames; unpacked now if it is not there yet.

    Raises:
        CaptureError: no depth or no camera_info (with the topics that there are), several cameras, nothing readable.
        MissingExtraError: the packages of the extra `logs` are not installed.
    """
    files = sorted(source.iterdir()) if source.is_dir() else [source]
    facts = [(f.name, f.stat().st_size, f.stat().st_mtime_ns) for f in files if f.is_file()]
    if sum(size for _, size, _ in facts) == 0:
        raise CaptureError("the recording is empty", file=source, found="0 bytes")
    key = digest(str(source.resolve()), facts, config.camera, config.max_time_difference, config.max_pose_gap)[:16]
    folder = default_folder() / "bags" / f"{source.stem}-{key}"
    if folder.is_dir():
        return folder
    bag = Bag(source, CaptureError)
    found = _first_look(bag)
    depth, color = _chosen(bag, found, config.camera)
    with output_folder(folder) as work:
        write_text(work / "frames.json", to_json(_unpack(bag, found, depth, color, work, config)))
    return folder


@dataclass
class Found:
    """What the first pass saw."""

    encodings: dict[str, str] = field(default_factory=dict)
    """Image topic -> encoding of its first image."""
    frames: dict[str, str] = field(default_factory=dict)
    """Image topic -> the frame that it is taken in."""
    cameras: dict[str, tuple[Intrinsics, bool]] = field(default_factory=dict)
    """camera_info topic -> camera, whether its lens distorts."""
    tree: Tree = field(default_factory=Tree)
    stamps: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """Image topic -> (header, reception) s of every image."""
    odometry: list[tuple[str, str, F64, float]] = field(default_factory=list)


def _first_look(bag: Bag) -> Found:
    found = Found()
    wanted = {*IMAGES, INFO, TF, OLD_TF, ODOMETRY}
    for topic, kind, message, received in bag.messages(lambda topic, kind: kind in wanted):
        if kind in IMAGES:
            found.encodings.setdefault(topic, encoding(message))
            found.frames.setdefault(topic, str(message.header.frame_id).lstrip("/"))
            found.stamps.setdefault(topic, []).append((stamp_of(message), received))
        elif kind == INFO:
            if topic not in found.cameras:
                found.cameras[topic] = camera_of(message)
        elif kind == ODOMETRY:
            pose = message.pose.pose
            T = matrix(pose.position, pose.orientation)
            found.odometry.append((message.header.frame_id, message.child_frame_id, T, stamp_of(message)))
        else:
            static = topic.endswith("tf_static")
            for t in message.transforms:
                T = matrix(t.transform.translation, t.transform.rotation)
                found.tree.add(t.header.frame_id, t.child_frame_id, T, stamp_of(t), static=static)
    carried = set(found.tree.parents)  # where tf has the odometry already, it is that of tf
    for parent, child, T, time in found.odometry:
        if child.lstrip("/") not in carried:
            found.tree.add(parent, child, T, time, static=False)
    return found


def _chosen(bag: Bag, found: Found, camera: str) -> tuple[str, str | None]:
    """(topic of depth, topic of colour or None)."""
    depths = [t for t, e in found.encodings.items() if is_depth(t, e) and t.startswith(camera)]
    usable = [t for t in depths if info_beside(t, found.cameras) is not None]
    if not usable:
        what = "camera_info of the depth" if depths else "depth images"
        # All topics, and why some were not decoded.
        lines = [f"{t} ({bag.failures.get(t, kind)})" for t, kind in list(bag.topics.items())[:24]]
        raise CaptureError(
            f"the recording has no {what}",
            file=bag.path,
            expected="depth (16UC1 or 32FC1, or compressedDepth), its camera_info beside it, colour, tf for poses",
            found="; ".join(lines + bag.notes[:2]) or "no topics",
            hint=f"--camera {camera!r} leaves out the others" if camera else None,
        )
    cameras = sorted({camera_name(t) for t in usable})
    if len(cameras) > 1:
        raise CaptureError(
            "the recording has several depth cameras", file=bag.path, expected="one of them", found=", ".join(cameras),
            hint=" or ".join(f"--camera {c}" for c in cameras),
        )  # fmt: skip
    colors = [t for t, kind in found.encodings.items() if _is_color(t, kind) and camera_name(t) == cameras[0]]
    colors = [t for t in colors if info_beside(t, found.cameras)] or colors
    color = min(colors, key=lambda t: (not re.search("colou?r|rgb", t), len(t)), default=None)
    # Depth that is registered to colour shares its frame.
    depth = min(usable, key=lambda t: (color is None or found.frames[t] != found.frames[color], len(t)))
    return depth, color


def _is_color(topic: str, kind: str) -> bool:
    codec = kind in ("jpeg", "jpg", "png") or any(kind.startswith(e) for e in COLORS)
    return codec and "depth" not in topic and "infra" not in topic


def _unpack(
    bag: Bag, found: Found, depth: str, color: str | None, work: Path, config: CaptureConfig
) -> Mapping[str, Any]:
    """Write depth/ and rgb/; returns what frames.json holds."""
    warnings, notes = list(found.tree.doubts), []
    by_header = _believed(found, [depth] + ([color] if color else []), warnings)
    clocks = {t: np.array([s[0 if by_header else 1] for s in found.stamps[t]]) for t in (depth, color) if t}
    of_depth, bent = info_beside(depth, found.cameras) or (None, False)
    assert of_depth is not None
    if bent:
        warnings.append("the depth camera's lens distorts: that is not undone")
    way, of_color, note = _registration(bag, found, depth, color, of_depth)
    notes += [f"depth is {depth}, colour is {color or 'none'}", note]
    order = np.argsort(clocks[depth], kind="stable")
    if (np.diff(clocks[depth]) <= 0).any():
        warnings.append("stamps of the depth images do not increase: sorted by time, repeated ones left out")
    times, first = np.unique(clocks[depth][order], return_index=True)
    keep = {int(i): k for k, i in enumerate(order[first])}
    partner: dict[int, int] = {}
    if color:
        stamps, at = np.unique(clocks[color], return_index=True)
        partner = {int(at[j]): i for i, j in associate(times, stamps, config.max_time_difference)}
    dropped = [(f"{times[i]:.6f}", f"no colour within {config.max_time_difference:g} s") for i in range(len(times))
               if color and i not in set(partner.values())]  # fmt: skip
    poses, pose_notes = _poses(found, found.frames[depth], times, config, by_header)
    used = set(partner.values()) if color else set(range(len(times)))
    rows: dict[int, dict[str, Any]] = {}
    seen = {depth: -1, color: -1}
    waiting: dict[int, np.ndarray] = {}
    wanted = {depth, color}
    for topic, _, message, _ in bag.messages(lambda t, kind: t in wanted):
        seen[topic] += 1
        index = keep.get(seen[topic]) if topic == depth else partner.get(seen[topic])
        if index is None or index not in used:
            continue
        name = f"{times[index]:.6f}"
        try:
            if topic == depth:
                image = depth_of(message)
                suffix, data = packed_depth(image)
                write_bytes(work / f"depth/{name}{suffix}", data)
                if way is not None:
                    values = image.astype(float) * (1.0 if image.dtype == np.float32 else 1e-3)
                    waiting[index] = np.where(np.isfinite(values), values, 0.0)
                row = rows.setdefault(index, {"name": name, "time": times[index], "color": None, "depth": None})
                row["depth"] = f"depth/{name}{suffix}"
            else:
                rows.setdefault(index, {"name": name, "time": times[index], "color": None, "depth": None})
                rows[index]["message"] = color_of(message)
            _finish_color(rows[index], waiting, index, way, work)
        except CaptureError as error:
            dropped.append((name, f"{error.message} ({error.found})" if error.found else error.message))
            used.discard(index)
            rows.pop(index, None)
            waiting.pop(index, None)
    good = [r for _, r in sorted(rows.items()) if r["depth"] and (r["color"] or not color)]
    for index, row in rows.items():
        row["pose"] = None if poses[index] is None else np.asarray(poses[index]).ravel().tolist()
        row.pop("message", None)
    notes += pose_notes
    warnings += bag.notes
    return {
        "depth_camera": vars(of_depth), "color_camera": None if of_color is None else vars(of_color),
        "colored": color is not None, "frames": good, "dropped": dropped, "notes": notes, "warnings": warnings,
    }  # fmt: skip


def _finish_color(row: dict[str, Any], waiting: dict[int, np.ndarray], at: int, way: Any, work: Path) -> None:
    """Write a frame's colour, once its depth is there too where it has to be seen from the depth camera."""
    import cv2

    if "message" not in row or (way is not None and at not in waiting):
        return
    image = row.pop("message")
    if way is not None:
        of_color, of_depth, T = way
        image = seen_from(image, of_color, waiting.pop(at), of_depth, T)
    row["color"] = f"rgb/{row['name']}.png"
    done, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert done
    write_bytes(work / row["color"], data.tobytes())


def _believed(found: Found, topics: list[str], warnings: list[str]) -> bool:
    """Whether headers' stamps are used; a clock that jumps against the receiver's, or stands still, is not."""
    for topic in topics:
        stamps = np.array(found.stamps[topic])
        wait = stamps[:, 1] - stamps[:, 0]
        if len(stamps) > 1 and (np.ptp(stamps[:, 0]) == 0 or (np.abs(np.diff(wait)) > JUMP).any()):
            warnings.append(f"the clock of {topic} jumps or stands still: times of reception are used")
            return False
    return True


def _registration(bag: Bag, found: Found, depth: str, color: str | None, of_depth: Intrinsics) -> Any:
    """((colour's camera, depth's, T) where colour must be resampled or None; colour's camera if another; in words)."""
    if color is None:
        return None, None, "there is no colour"
    info = info_beside(color, found.cameras)
    of_color = info[0] if info else None
    if found.frames[depth] == found.frames[color] or of_color is None:
        same = of_color is None or (of_color.width, of_color.height) == (of_depth.width, of_depth.height)
        note = (
            "depth and colour are taken in one frame" if of_color else "colour has no camera_info: the depth's is used"
        )
        return None, None if same else of_color, note
    T = found.tree.between(found.frames[color], found.frames[depth])
    if T is None:
        raise CaptureError(
            "depth and colour are taken in different frames, and tf does not say how they lie",
            file=bag.path,
            expected=f"a fixed transform between {found.frames[depth]} and {found.frames[color]} (tf_static), or "
            "depth registered to colour (aligned_depth_to_color)",
            found=", ".join(sorted(found.tree.parents)[:12]) or "no tf",
        )
    return (of_color, of_depth, T), None, "colour is resampled at the pixels of the depth, by tf and both camera_infos"


def _poses(
    found: Found, frame: str, times: F64, config: CaptureConfig, by_header: bool
) -> tuple[list[F64 | None], list[str]]:
    """Poses of the depth camera, and notes about them."""
    tree = found.tree
    if not tree.moves(frame):
        return [None] * len(times), ["tf moves nothing above the camera: poses are found from the frames"]
    if not by_header:
        return [None] * len(times), ["tf is on another clock than the images: poses are found from the frames"]
    notes = [
        f"poses are those of {frame} in {tree.root(frame)} by tf, interpolated over at most {config.max_pose_gap:g} s; "
        "up is its z axis",
    ]
    if "optical" not in frame:
        notes.append(f"{frame} is taken for an optical frame (x right, y down, z forward)")
    return tree.poses(frame, times, config.max_pose_gap), notes


LAYOUT = Layout(
    "rosbag",
    "a ROS bag (.bag, or a folder with metadata.yaml) or .mcap with a depth camera (extra logs)",
    recognise,
    read,
)
