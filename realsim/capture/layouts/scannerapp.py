"""3D Scanner App, export "All Data": frame_00000.json, frame_00000.jpg, depth_00000.png, conf_00000.png.

Every frame has a JSON with `cameraPoseARFrame` (4x4, row by row, camera to world in ARKit's axes and world) and
`intrinsics` (3x3, row by row, of the colour image), and depth in millimetres; only some have a colour image.
"""

from pathlib import Path

from realsim.capture.arkit import AXES_NOTE, BEST_CONFIDENCE, GRIDS_NOTE, UP, WORLD_NOTE, from_opengl
from realsim.capture.assemble import View, capture, depth_unit, frames_with, on_two_grids, require_both, sizes_of
from realsim.capture.config import CaptureConfig
from realsim.capture.images import COLOR_SUFFIXES, ConfidenceImage
from realsim.capture.intrinsics import camera_from_mapping, no_intrinsics
from realsim.capture.layout import PHONE, Layout, Recognition
from realsim.capture.listing import Pair, lacking, list_files, natural_key
from realsim.capture.poses import matrix_of
from realsim.core.errors import CaptureError
from realsim.core.files import read_json
from realsim.core.types import FrameSet

POSE = "cameraPoseARFrame"


def numbered(folder: Path, prefix: str, suffixes: tuple[str, ...]) -> dict[str, Path]:
    """Number in the file name (as written) -> file, for files `prefix_NUMBER.suffix`."""
    found = [p for p in list_files(folder, suffixes) if p.stem.startswith(f"{prefix}_")]
    return {n: p for p in found if (n := p.stem.removeprefix(f"{prefix}_")).isdigit()}


def recognise(folder: Path) -> Recognition:
    facts, depth = numbered(folder, "frame", (".json",)), numbered(folder, "depth", (".png",))
    if not facts and not depth:  # numbered pictures alone could be anybody's
        return Recognition()
    found = {"frame_*.json": facts, "depth_*.png": depth, "frame_*.jpg": numbered(folder, "frame", COLOR_SUFFIXES)}
    evidence = tuple(f"{len(files)} x {name}" for name, files in found.items() if files)
    what = ("intrinsics", "depth images", "colour images")
    missing = lacking({f"{kind} ({name})": files for kind, (name, files) in zip(what, found.items(), strict=True)})
    return Recognition(evidence, missing, score=30)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    color, depth = numbered(folder, "frame", COLOR_SUFFIXES), numbered(folder, "depth", (".png",))
    sure, facts = numbered(folder, "conf", (".png",)), numbered(folder, "frame", (".json",))
    require_both(color, depth, folder, "depth_*.png and frame_*.jpg", 'export the scan as "All Data"')
    if not facts:
        raise no_intrinsics(folder, ("frame_*.json",), 'export the scan as "All Data"')
    color_size, depth_size = sizes_of(color.values(), depth.values())
    unit = depth_unit(0.001, "3D Scanner App's convention", config)
    pairs = [Pair(n, color[n], depth.get(n)) for n in sorted(color, key=natural_key)]

    def view_of(pair: Pair) -> View:
        if pair.name not in facts:
            raise CaptureError(f"there is no frame_{pair.name}.json")
        source = facts[pair.name]
        data = read_json(source)
        of_depth, of_color = on_two_grids(camera_from_mapping(data, source).sized(color_size), depth_size)
        pose = None if config.ignore_poses else from_opengl(matrix_of(data.get(POSE), POSE, source))
        confidence = ConfidenceImage(sure[pair.name], BEST_CONFIDENCE) if pair.name in sure else None
        time = data.get("time")
        known = isinstance(time, (int, float)) and not isinstance(time, bool)
        return View(of_depth, of_color, pose, float(time) if known else None, confidence)

    frames, dropped = frames_with(pairs, unit, view_of)
    colorless = len(depth.keys() - color.keys())
    assumptions = [unit.note, GRIDS_NOTE, "every frame has intrinsics of its own"]
    if colorless:
        assumptions.append(f"{colorless} depth images have no colour image (the app keeps a few) and are not used")
    assumptions += [] if config.ignore_poses else [AXES_NOTE, WORLD_NOTE]
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, up_world=None if config.ignore_poses else UP)


LAYOUT = Layout(
    "scannerapp", 'frame_*.json, frame_*.jpg and depth_*.png: "All Data" of 3D Scanner App', recognise, read, PHONE
)
