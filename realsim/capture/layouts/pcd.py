"""A folder of organised PCD files: each is a depth image in disguise, one point per pixel.

The camera is recovered from the points themselves: u = fx x/z + cx holds exactly for a pinhole camera. That also
settles the trap of PCD's VIEWPOINT entry, which some writers fill with a flip of axes that the points do not need,
some with the sensor's pose, and some with a pose that is already applied: the reading whose points fit a camera wins.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from realsim.capture.assemble import capture, one_line
from realsim.capture.config import CaptureConfig
from realsim.capture.intrinsics import check
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import list_files
from realsim.capture.pcdfile import PcdHeader, read_header, read_points
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.geometry import invert_T, make_T, transform
from realsim.core.types import F32, F64, U8, Dropped, Frame, FrameSet, Intrinsics

FIT_LIMIT_PX = 0.5
"""Median distance between the pixels of the grid and the projected points up to which a camera fits."""
AXES = {
    "x right, y down, z forward (optical)": np.eye(3),
    "x right, y up, z backward (OpenGL)": np.diag([1.0, -1, -1]),
    "x forward, y left, z up (ROS body)": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
}
"""Name of a sensor's axes -> rotation from them to optical axes."""


@dataclass(frozen=True)
class Reading:
    """How the stored points become camera points: T_camera_stored, the same for all files or from each VIEWPOINT."""

    axes: str
    undo_viewpoint: bool
    """Whether the stored points are in the world and each file's VIEWPOINT has to be inverted."""
    camera: Intrinsics

    def T_camera_stored(self, header: PcdHeader) -> F64:
        """(4, 4)."""
        to_optical = make_T(AXES[self.axes])
        return to_optical @ invert_T(header.T_world_sensor) if self.undo_viewpoint else to_optical


@dataclass(frozen=True)
class CloudDepth:
    """`()` -> (H, W) float32 metres along the optical axis, 0 where the cloud has no point."""

    path: Path
    T_camera_stored: F64
    camera: Intrinsics

    def __call__(self) -> F32:
        points = transform(self.T_camera_stored, read_points(self.path)[0])
        error = reprojection_px(points, self.camera)
        if error > FIT_LIMIT_PX:
            raise CaptureError("the points do not fit the capture's camera", file=self.path, found=f"{error:.2g} px")
        z = points[..., 2].astype(np.float32)
        return np.where(np.isfinite(z) & (z > 0), z, np.float32(0))


@dataclass(frozen=True)
class CloudColor:
    """`()` -> (H, W, 3) uint8 RGB of the points."""

    path: Path

    def __call__(self) -> U8:
        color = read_points(self.path)[1]
        if color is None:
            raise CaptureError("no colour in this point cloud", file=self.path)
        return color


def recognise(folder: Path) -> Recognition:
    files = list_files(folder, (".pcd",))
    if not files:
        return Recognition()
    try:
        header = read_header(files[0])
    except RealsimError as error:
        return Recognition((f"{len(files)} x *.pcd",), (f"a readable header ({error.message})",), score=20)
    if not header.organised and len(files) == 1:
        return Recognition()  # a scan
    if not header.organised:
        return Recognition((f"{len(files)} x *.pcd",), ("organised point clouds (HEIGHT more than 1)",), score=20)
    return Recognition((f"{len(files)} x *.pcd, organised {header.width}x{header.height}",), (), score=20)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    headers: dict[Path, PcdHeader] = {}
    dropped: list[Dropped] = []
    for path in list_files(folder, (".pcd",)):
        try:
            header = read_header(path)
        except RealsimError as error:
            dropped.append(Dropped(path.stem, one_line(error)))
            continue
        if header.organised:
            headers[path] = header
        else:
            dropped.append(Dropped(path.stem, "not an organised point cloud"))
    if not headers:
        raise CaptureError(
            "no organised point cloud",
            file=folder,
            expected="PCD files with HEIGHT more than 1",
            found="; ".join(d.reason for d in dropped[:3]) or "none",
        )
    reading, residual = find_reading(headers)
    posed, viewpoint_note = _viewpoints(headers, reading)
    colored = all(h.color_field for h in headers.values())
    frames = tuple(
        Frame(
            path.stem,
            reading.camera,
            CloudDepth(path, reading.T_camera_stored(header), reading.camera),
            CloudColor(path) if colored else None,
            T_world_camera=header.T_world_sensor @ make_T(AXES[reading.axes].T)
            if posed and not config.ignore_poses
            else None,
            files=(path,),
        )
        for path, header in headers.items()
    )
    c = reading.camera
    assumptions = [
        "points are in metres",
        f"the sensor's axes are {reading.axes}: so the points fit a pinhole camera",
        f"intrinsics recovered from the points: fx {c.fx:.3f} fy {c.fy:.3f} cx {c.cx:.3f} cy {c.cy:.3f} "
        f"(residual {residual:.3f} px)",
        viewpoint_note,
        "colour is that of the points" if colored else "the point clouds have no colour",
    ]
    return capture(folder, LAYOUT.name, frames, tuple(dropped), assumptions)


def find_reading(headers: dict[Path, PcdHeader]) -> tuple[Reading, float]:
    """The first reading of axes and VIEWPOINT under which the first usable cloud fits a camera, and its residual (px).

    Raises:
        CaptureError: no reading fits.
    """
    best = np.inf
    for path, header in headers.items():
        try:
            points = read_points(path)[0]
        except RealsimError:
            continue
        for undo in (False, True):
            stored = transform(invert_T(header.T_world_sensor), points) if undo else points
            for axes, R in AXES.items():
                camera = fit_pinhole(stored @ R.T)
                if camera is None:
                    continue
                residual = reprojection_px(stored @ R.T, camera)
                if residual <= FIT_LIMIT_PX:
                    return Reading(axes, undo, check(camera, path)), residual
                best = min(best, residual)
        break
    raise CaptureError(
        "the points of the cloud lie on no camera's pixel grid",
        file=next(iter(headers)),
        expected=f"organised points that a pinhole camera projects to their pixels within {FIT_LIMIT_PX} px",
        found=f"{best:.2g} px" if np.isfinite(best) else "too few points in front of the camera",
        hint="unrectified or resampled clouds have to be turned into depth images first",
    )


def fit_pinhole(points: F64 | F32) -> Intrinsics | None:
    """The camera that projects organised points (H, W, 3) to their own pixels; None if none does.

    Least squares of u = fx x/z + cx and v = fy y/z + cy over the valid points.
    """
    height, width = points.shape[:2]
    rows, cols = np.nonzero(np.isfinite(points).all(-1) & (points[..., 2] > 1e-3))
    if len(rows) < 100:
        return None
    # Ten thousand evenly spread pixels determine four numbers as well as all of them.
    step = max(len(rows) // 10_000, 1)
    rows, cols = rows[::step], cols[::step]
    x, y, z = points[rows, cols].astype(np.float64).T
    (fx, cx), (fy, cy) = _line(x / z, cols), _line(y / z, rows)
    if fx <= 0 or fy <= 0:
        return None
    return Intrinsics(width, height, fx, fy, cx, cy)


def _line(slope: F64, pixel: np.ndarray) -> tuple[float, float]:
    solution, *_ = np.linalg.lstsq(np.stack([slope, np.ones_like(slope)], 1), pixel.astype(float), rcond=None)
    return float(solution[0]), float(solution[1])


def reprojection_px(points: F64 | F32, camera: Intrinsics) -> float:
    """Median distance between pixels and projected points over every 7th valid pixel; 0 without any."""
    rows, cols = np.nonzero(np.isfinite(points).all(-1) & (points[..., 2] > 1e-3))
    rows, cols = rows[::7], cols[::7]
    if not len(rows):
        return 0.0
    x, y, z = points[rows, cols].astype(np.float64).T
    return float(np.median(np.hypot(camera.fx * x / z + camera.cx - cols, camera.fy * y / z + camera.cy - rows)))


def _viewpoints(headers: dict[Path, PcdHeader], reading: Reading) -> tuple[bool, str]:
    """(whether VIEWPOINT gives the poses, what it says and what was done with it)."""
    viewpoints: Sequence[tuple[float, ...]] = sorted({h.viewpoint for h in headers.values()})
    if len(viewpoints) == 1:
        text = " ".join(f"{v:g}" for v in viewpoints[0])
        if reading.undo_viewpoint:
            return False, f"VIEWPOINT is {text} in all files and was taken back: only then the points fit a camera"
        if viewpoints[0] == (0, 0, 0, 1, 0, 0, 0):
            return False, "VIEWPOINT is the identity in all files: no poses are given"
        return False, f"VIEWPOINT is {text} in all files and was not applied: the points fit a camera as they are"
    if reading.undo_viewpoint:
        return True, "VIEWPOINT differs between files and is used as poses; it was taken back from the points"
    return True, "VIEWPOINT differs between files and is used as the poses of the sensor (sensor to world, metres)"


LAYOUT = Layout("pcd", "organised *.pcd files (HEIGHT more than 1)", recognise, read)
