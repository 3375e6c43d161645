"""Polycam's raw data: keyframes/ with images, depth, confidence, cameras, and the corrected ones where it made them.

Format: https://github.com/PolyCam/polyform (README, "Polycam's data format"). Depth is in millimetres, confidence 0,
127 or 255; `t_ij` is the camera-to-world matrix row by row in ARKit's axes and world.
"""

from pathlib import Path

from realsim.capture.arkit import AXES_NOTE, GRIDS_NOTE, UP, WORLD_NOTE, from_opengl
from realsim.capture.assemble import View, capture, depth_unit, frames_with, on_two_grids, size_of_depth
from realsim.capture.config import CaptureConfig
from realsim.capture.images import COLOR_SUFFIXES, ConfidenceImage
from realsim.capture.intrinsics import camera_from_mapping, no_intrinsics
from realsim.capture.layout import PHONE, Layout, Recognition
from realsim.capture.listing import Pair, lacking, list_files, pair_by_stem
from realsim.capture.poses import matrix_of
from realsim.core.errors import CaptureError, PoseError
from realsim.core.files import read_json
from realsim.core.types import FrameSet

FOLDERS = {"corrected": ("corrected_images", "corrected_cameras"), "as recorded": ("images", "cameras")}
"""In the order of preference."""
MATRIX_KEYS = [[f"t_{row}{column}" for column in range(4)] for row in range(3)]


def keyframes(folder: Path) -> Path:
    """The folder that holds images/, cameras/ and depth/: `keyframes`, or the given one itself."""
    return folder / "keyframes" if (folder / "keyframes").is_dir() else folder


def complete_set(root: Path) -> str | None:
    """The preferred kind of images and cameras that is there, or None."""
    for kind, (images, cameras) in FOLDERS.items():
        if list_files(root / images, COLOR_SUFFIXES) and list_files(root / cameras, (".json",)):
            return kind
    return None


def recognise(folder: Path) -> Recognition:
    root = keyframes(folder)
    cameras = [name for _, name in FOLDERS.values() if list_files(root / name, (".json",))]
    # Without any camera only the name of the folder speaks for this layout.
    if not cameras and root == folder:
        return Recognition()
    kind = complete_set(root)
    missing = lacking(
        {
            "intrinsics (cameras/*.json)": cameras,
            "depth images (keyframes/depth/*.png)": list_files(root / "depth", (".png",)),
            "colour images (keyframes/images/)": not cameras or kind is not None,
        }
    )
    evidence = [f"{root.name}/{name}/*.json" for name in cameras] + ["keyframes/"] * (not cameras)
    return Recognition(tuple(evidence), missing, score=35)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    root = keyframes(folder)
    kind = complete_set(root)
    depth = list_files(root / "depth", (".png",))
    if not depth:
        raise CaptureError("colour without depth", file=root, expected="depth/*.png: exported as raw data, LiDAR mode")
    if kind is None:
        raise no_intrinsics(root, ("cameras/*.json with images/",), "export the capture as raw data (developer mode)")
    images, cameras = FOLDERS[kind]
    color = list_files(root / images, COLOR_SUFFIXES)
    pairs, _ = pair_by_stem(color, depth)
    depth_size = size_of_depth(depth)
    unit = depth_unit(0.001, "Polycam's convention", config)
    sure = {p.stem: p for p in list_files(root / "confidence", (".png",))}
    unknown = [] if len(sure) else ["there are no confidence maps"]

    def view_of(pair: Pair) -> View:
        source = root / cameras / f"{pair.name}.json"
        data = read_json(source)
        camera = camera_from_mapping(data, source)
        if camera.width is None or camera.height is None:
            raise CaptureError("the camera file lacks the image size", file=source, expected="width and height")
        of_depth, of_color = on_two_grids(camera.sized((camera.width, camera.height)), depth_size)
        pose = None
        if not config.ignore_poses:
            if missing := [key for row in MATRIX_KEYS for key in row if key not in data]:
                raise PoseError(
                    "no camera pose", file=source, expected="numbers t_00 to t_23", found=f"no {missing[0]}"
                )
            rows = [[data[key] for key in row] for row in MATRIX_KEYS]
            pose = from_opengl(matrix_of(rows, "t_00 to t_23", source))
        confidence = ConfidenceImage(sure[pair.name], 255) if pair.name in sure else None
        # File names are microseconds.
        time = int(pair.name) * 1e-6 if pair.name.isdigit() else None
        return View(of_depth, of_color, pose, time, confidence)

    frames, dropped = frames_with(pairs, unit, view_of)
    origin = {
        "corrected": "corrected images and cameras are used: undistorted, poses optimised by Polycam",
        "as recorded": "there are no corrected images and cameras: those of ARKit are used, which drift, and the "
        "images are slightly distorted",
    }[kind]
    assumptions = [origin, unit.note, GRIDS_NOTE, *unknown, "frames are named by their time in microseconds"]
    assumptions += [] if config.ignore_poses else [AXES_NOTE, WORLD_NOTE]
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, up_world=None if config.ignore_poses else UP)


LAYOUT = Layout(
    "polycam",
    "keyframes/ with cameras/ (or corrected_cameras/), images/ and depth/: Polycam's raw data",
    recognise,
    read,
    PHONE,
)
