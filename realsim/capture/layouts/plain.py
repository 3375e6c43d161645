"""A plain folder: rgb|color|images/, depth/, and intrinsics.json|yaml|txt. No poses."""

from pathlib import Path

from realsim.capture.assemble import View, cameras, capture, depth_unit, frames_with
from realsim.capture.config import CaptureConfig
from realsim.capture.intrinsics import no_intrinsics, read_camera
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import (
    color_folder,
    depth_folder,
    first_file,
    image_files,
    lacking,
    pair_by_stem,
)
from realsim.core.errors import CaptureError
from realsim.core.types import FrameSet

STEMS = ("intrinsics", "intrinsic", "camera", "camera_intrinsics", "camera_info", "calibration")
INTRINSICS = tuple(f"{stem}{suffix}" for stem in STEMS for suffix in (".json", ".yaml", ".yml", ".txt"))


def intrinsics_file(folder: Path) -> Path | None:
    return first_file(folder, INTRINSICS)


def recognise(folder: Path) -> Recognition:
    color, depth, camera = color_folder(folder), depth_folder(folder), intrinsics_file(folder)
    if color is None and depth is None:
        return Recognition()
    evidence = [f"{p.name}/" for p in (color, depth) if p is not None] + ([camera.name] if camera else [])
    parts = {"depth images (depth/)": depth, "intrinsics (intrinsics.json, .yaml or .txt)": camera}
    return Recognition(tuple(evidence), lacking(parts), score=5)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    (color, depth), source = image_files(folder), intrinsics_file(folder)
    if not depth:
        raise CaptureError("colour without depth", file=folder, expected="depth/ with 16-bit PNG or float images")
    if source is None:
        raise no_intrinsics(folder, ("intrinsics.json", "intrinsics.yaml", "intrinsics.txt"))
    pairs, rule = pair_by_stem(color, depth, config.max_time_difference)
    camera = read_camera(source)
    of_depth, of_color, assumed = cameras(camera, color, depth)
    unit = depth_unit(0.001, "the usual convention; this layout has none of its own", config, camera)
    frames, dropped = frames_with(pairs, unit, lambda pair: View(of_depth, of_color), with_color=bool(color))
    assumptions = [*camera.notes, *assumed, unit.note]
    assumptions += [rule, "depth is registered to colour"] if color else ["there is no colour"]
    assumptions.append("this layout has no poses: they have to be estimated")
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, camera.warnings)


LAYOUT = Layout("plain", "depth/ and intrinsics.json|yaml|txt, with rgb/, color/ or images/", recognise, read)
