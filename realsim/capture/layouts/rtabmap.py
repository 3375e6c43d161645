"""RTAB-Map's export: NAME_rgb/, NAME_depth/, NAME_calib/ (or one YAML), NAME_camera_poses.txt or NAME_poses.txt.

Conventions (introlab/rtabmap, tools/Export; its database viewer leaves NAME_ out): files are called by node or by time,
depth is in mm. `_poses` are those of the robot, on which `local_transform` of the calibration puts the camera (optical
axes); `_camera_poses` are the camera's. A row is 12 numbers of a matrix, or `time x y z qx qy qz qw`, then the node.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.capture.assemble import View, capture, depth_unit, frames_with, on_two_grids, require_both, sizes_of
from realsim.capture.config import CaptureConfig
from realsim.capture.images import COLOR_SUFFIXES, DEPTH_SUFFIXES
from realsim.capture.intrinsics import Camera, camera_from_mapping, no_intrinsics, read_opencv_yaml
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import lacking, list_files, pair_by_stem, pose_file
from realsim.capture.numbers import table_of
from realsim.capture.poses import matrix_of, read_rows
from realsim.core.errors import CaptureError, PoseError
from realsim.core.files import read_text
from realsim.core.geometry import make_T, quat_to_R
from realsim.core.types import F64, FrameSet

YAML = (".yaml", ".yml")
COLUMNS = {
    8: "time x y z qx qy qz qw",
    9: "time x y z qx qy qz qw node",
    12: "r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz",
}
SAME = 1e-3
"""Seconds within which a row's time and a file's are one."""


def find_name(folder: Path) -> str | None:
    """What stands before `rgb` and `depth`, with its underscore; None if this is no such folder."""
    names = [p.name.removesuffix("rgb") for p in sorted(folder.glob("*rgb")) if p.is_dir()]
    named = [n for n in names if n.endswith("_") and (folder / f"{n}depth").is_dir()]
    bare = "" in names and (folder / "depth").is_dir() and (folder / "calib").is_dir()
    return named[0] if named else "" if bare else None


def calibrations(folder: Path, name: str) -> list[Path]:
    """One file an image, or one for all."""
    return list_files(folder / f"{name}calib", YAML) or list_files(folder, YAML)[:1]


def recognise(folder: Path) -> Recognition:
    if (name := find_name(folder)) is None:
        return Recognition()
    missing = lacking({f"intrinsics ({name}calib/*.yaml)": calibrations(folder, name)})
    return Recognition((f"{name}rgb/", f"{name}depth/"), missing, score=30)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    name = find_name(folder)
    if name is None:
        raise CaptureError("no export of RTAB-Map's", file=folder, expected="NAME_rgb/ and NAME_depth/")
    color, depth = (
        list_files(folder / f"{name}rgb", COLOR_SUFFIXES),
        list_files(folder / f"{name}depth", DEPTH_SUFFIXES),
    )
    require_both(color, depth, folder, f"{name}rgb/ and {name}depth/ with images")
    files = {path.stem: path for path in calibrations(folder, name)}
    if not files:
        raise no_intrinsics(folder, (f"{name}calib/*.yaml",), "export the images anew, with their calibration")
    pairs, rule = pair_by_stem(color, depth)
    color_size, depth_size = sizes_of(color, depth)
    own = next(iter(files)) if len(files) == 1 else None
    of_file = {stem: read_calibration(path) for stem, path in files.items()}
    camera = next(iter(of_file.values()))[0]
    unit = depth_unit(0.001, "RTAB-Map's convention", config, camera)
    path = None if config.ignore_poses else pose_file(folder, (f"{name}camera_poses.txt", f"{name}poses.txt"))
    poses = {} if path is None else read_poses(path, [pair.name for pair in pairs])
    of_robot = path is not None and path.name == f"{name}poses.txt"

    def view_of(pair: Any) -> View:
        if (stem := own or pair.name) not in of_file:
            raise CaptureError("there is no calibration for this frame")
        lens, on_robot = of_file[stem]
        of_depth, of_color = on_two_grids(lens.sized(color_size), depth_size)
        T = poses.get(pair.name)
        if of_robot and T is not None:
            if on_robot is None:
                raise PoseError("its calibration has no local_transform: where the camera is on the robot is not known")
            T = T @ on_robot
        return View(of_depth, of_color, T)

    frames, dropped = frames_with(pairs, unit, view_of)
    assumptions = [*camera.notes, unit.note, rule, "depth is registered to colour"]
    if path is not None:
        whose = "the robot, on which local_transform puts the camera" if of_robot else "the camera"
        assumptions.append(f"{path.name}: poses of {whose}, in metres")
    return capture(folder, LAYOUT.name, frames, dropped, assumptions, camera.warnings)


def read_calibration(path: Path) -> tuple[Camera, F64 | None]:
    """The camera, and (4, 4) its place on the robot if the file says.

    It is taken from the projection matrix: versions until 2024 wrote the camera matrix with its last row in the wrong
    place (issue 1253).
    """
    data = read_opencv_yaml(path)
    if isinstance(data, Mapping) and isinstance(data.get("projection_matrix"), Mapping):
        P = table_of(data["projection_matrix"].get("data") or [])
        if P.size == 12:
            data = {**data, "camera_matrix": P.reshape(3, 4)[:, :3].tolist()}
    camera = camera_from_mapping(data, path).y_down()
    local = data.get("local_transform")
    cells = local.get("data") if isinstance(local, Mapping) else None
    if not isinstance(cells, list):
        return camera, None
    return camera, matrix_of([cells[k : k + 4] for k in range(0, len(cells), 4)], "local_transform", path)


def read_poses(path: Path, names: Sequence[str]) -> dict[str, F64]:
    """(4, 4) of the frames, by their node or time, or in order where rows have neither.

    Raises:
        PoseError: rows of another kind, or another number of them where only the order tells whose they are.
    """
    lines = [line for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")]
    count = len(lines[0].split()) if lines else 9
    rows = np.array(list(read_rows(path, COLUMNS.get(count, COLUMNS[9])))).reshape(-1, count)
    if count == 12:
        T = np.concatenate([rows.reshape(-1, 3, 4), np.tile([[[0.0, 0, 0, 1]]], (len(rows), 1, 1))], 1)
    else:  # a row of a node that was lost holds NaN or zeros
        rows = rows[np.isfinite(rows).all(1) & (np.abs(np.linalg.norm(rows[:, 4:8], axis=1) - 1) < 0.05)]
        T = np.array([make_T(quat_to_R(row[[7, 4, 5, 6]]), row[1:4]) for row in rows])
    found: dict[str, F64] = {}
    if count == 9 and all(name.isdigit() for name in names):
        found = dict(zip((str(int(node)) for node in rows[:, 8]), T, strict=True))
    elif count < 12 and len(rows) and all("." in name and name.replace(".", "", 1).isdigit() for name in names):
        nearest = {name: int(np.abs(rows[:, 0] - float(name)).argmin()) for name in names}
        found = {name: T[k] for name, k in nearest.items() if abs(rows[k, 0] - float(name)) < SAME}
    elif len(rows) == len(names):
        found = dict(zip(names, T, strict=True))
    if not found.keys() & set(names):
        raise PoseError(
            "nothing tells which pose belongs to which image",
            file=path,
            expected=f"{len(names)} rows in their order, or rows with their node or time",
            found=f"{len(rows)} rows of {count} numbers",
            hint="export poses with node or time (--poses_format 11)",
        )
    return found


LAYOUT = Layout("rtabmap", "NAME_rgb/, NAME_depth/, NAME_calib/ as rtabmap-export leaves them", recognise, read)
