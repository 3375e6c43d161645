"""7-Scenes, tsdf-fusion, BundleFusion: frame-XXXXXX.color.*, frame-XXXXXX.depth.png, frame-XXXXXX.pose.txt together.

Sources: the 7-Scenes page of Microsoft Research (depth in mm, 65535 invalid, pose camera to world) and tsdf-fusion's
README (depth 0 invalid, `camera-intrinsics.txt` a 3x3 matrix); BundleFusion's `info.txt`, in 3RScan `_info.txt`.
"""

from pathlib import Path

from realsim.capture.assemble import View, cameras, capture, depth_unit, frames_with
from realsim.capture.config import CaptureConfig
from realsim.capture.intrinsics import no_intrinsics, read_camera
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import Pair, first_file, natural_key
from realsim.capture.poses import pose_in
from realsim.core.errors import CaptureError
from realsim.core.types import FrameSet

INTRINSICS = ("camera-intrinsics.txt", "intrinsics.txt", "intrinsics.json", "intrinsics.yaml", "info.txt", "_info.txt")


def frame_files(folder: Path) -> dict[str, dict[str, Path]]:
    """frame name -> its files by role (`color`, `depth`, `pose`), in natural order."""
    found: dict[str, dict[str, Path]] = {}
    for path in sorted(folder.glob("frame-*.*.*")):
        name, role = path.name.split(".")[:2]
        if role in ("color", "depth", "pose"):
            found.setdefault(name, {})[role] = path
    return {name: found[name] for name in sorted(found, key=natural_key)}


def intrinsics_file(folder: Path) -> Path | None:
    """Beside the frames, or one folder up (the datasets keep one file for several sequences)."""
    return first_file(folder, INTRINSICS) or first_file(folder.parent, INTRINSICS)


def recognise(folder: Path) -> Recognition:
    files = frame_files(folder)
    if not files:
        return Recognition()
    counts = {role: sum(role in f for f in files.values()) for role in ("color", "depth", "pose")}
    evidence = tuple(f"{n} x frame-*.{role}.*" for role, n in counts.items() if n)
    missing = [f"{what} (frame-*.{r}.*)" for r, what in (("color", "colour"), ("depth", "depth")) if not counts[r]]
    if intrinsics_file(folder) is None:
        missing.append(f"intrinsics ({', '.join(INTRINSICS)})")
    return Recognition(evidence, tuple(missing), score=30)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    files = frame_files(folder)
    if not any("depth" in f for f in files.values()):
        raise CaptureError("colour without depth", file=folder, expected="frame-XXXXXX.depth.png")
    source = intrinsics_file(folder)
    if source is None:
        # The dataset's authors recommend these figures for their own camera; another capture must not inherit them.
        hint = "for the 7-Scenes dataset itself, write `585 585 320 240 640 480` into intrinsics.txt"
        raise no_intrinsics(folder, INTRINSICS, hint)
    camera = read_camera(source)
    pairs = [Pair(name, f.get("color"), f.get("depth")) for name, f in files.items()]
    of_depth, of_color, assumed = cameras(
        camera, [p.color for p in pairs if p.color], [p.depth for p in pairs if p.depth]
    )
    unit = depth_unit(0.001, "7-Scenes' convention", config, camera)
    posed = {} if config.ignore_poses else {name: f["pose"] for name, f in files.items() if "pose" in f}
    frames, dropped = frames_with(pairs, unit, lambda pair: View(of_depth, of_color, pose_in(posed, pair.name)))
    assumptions = [
        *camera.notes,
        f"the camera is that of {source}",
        *assumed,
        unit.note,
        "depth 0 and 65535 are invalid",
        "depth is taken to be registered to colour, until the frames show otherwise (7-Scenes itself is not)",
    ]
    if posed:
        assumptions.append("poses are camera to world in metres, OpenCV camera axes, one file per frame")
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, camera.warnings)


LAYOUT = Layout(
    "sevenscenes",
    "frame-XXXXXX.color.*, frame-XXXXXX.depth.png, camera-intrinsics.txt; frame-XXXXXX.pose.txt for poses",
    recognise,
    read,
)
