"""Camera parameters as people write them down, to `Intrinsics`, with the convention that was found in words."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from realsim.capture.numbers import table_of
from realsim.core.errors import CaptureError
from realsim.core.files import parse_yaml, read_json, read_text
from realsim.core.types import F64, Intrinsics

MATRIX_KEYS = ("intrinsic_matrix", "camera_matrix", "K", "k", "intrinsics", "intrinsic", "matrix")
WIDTH_KEYS, HEIGHT_KEYS = ("width", "image_width", "w"), ("height", "image_height", "h")
DEPTH_UNIT_KEYS = ("depth_scale", "depth_unit", "depth_factor", "png_depth_scale", "DepthMapFactor", "scale")
FIELD_OF_VIEW_DEG = (5.0, 170.0)
OFF_CENTRE = (0.1, 0.2)
"""Of the image's size, that a principal point may lie off the middle: beyond the first it is doubtful; beyond the
second it belongs to images of another size, where the file names none. Real cameras (iPhone, RealSense, Kinect, Xtion)
have at most 0.04; figures of the next larger common size have 0.17 (1280x720 for 960x540) to 0.5."""


@dataclass(frozen=True)
class Camera:
    """Camera parameters of a file; the image size may be unknown."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int | None
    height: int | None
    source: Path
    notes: tuple[str, ...] = ()
    """Conventions that were found, one sentence each."""
    warnings: tuple[str, ...] = ()
    depth_unit: float | None = None
    """Metres per step of integer depth, if the file states it."""

    def sized(self, size: tuple[int, int]) -> Intrinsics:
        """Checked intrinsics of images of that (width, height).

        Raises:
            CaptureError: the file speaks of another size, or the figures cannot be a camera of this size.
        """
        if (self.width, self.height) not in ((None, None), size):
            raise CaptureError(
                "the images are of another size than their intrinsics",
                file=self.source,
                expected=f"{self.width}x{self.height} pixels",
                found=f"{size[0]}x{size[1]} pixels",
                hint="give the intrinsics of the images that are in the folder",
            )
        camera = check(Intrinsics(*size, self.fx, self.fy, self.cx, self.cy), self.source)
        if self.width is None and off_centre(camera) > OFF_CENTRE[1]:
            raise CaptureError(
                "the intrinsics are of images of another size",
                file=self.source,
                expected=f"a principal point near the middle of {size[0]}x{size[1]} pixels",
                found=f"({self.cx:g}, {self.cy:g}), as of images of about {2 * self.cx:.0f}x{2 * self.cy:.0f}",
                hint="give the intrinsics of the images as they are in the folder; for images that were cropped write "
                f"`{self.fx:g} {self.fy:g} {self.cx:g} {self.cy:g} {size[0]} {size[1]}` into intrinsics.txt instead",
            )
        return camera

    def y_down(self) -> Camera:
        """The same with a positive fy: a negative one (ICL-NUIM) means a camera axis y that points up, while the rows
        of the images go down as ever."""
        if not (np.isfinite(self.fy) and self.fy < 0 < self.fx):
            return self
        note = (
            f"fy is {self.fy:g}: the file's y axis points up; {-self.fy:g} was taken, with y down as the rows go. "
            "Poses of such a camera may be mirrored: they are checked against the depth"
        )
        return replace(self, fy=-self.fy, notes=(*self.notes, note))


def camera_matrix(values: ArrayLike, source: Path) -> tuple[F64, str]:
    """A 3x3 camera matrix from nine (or 4x4: sixteen) numbers, and how it was written.

    Row by row the principal point is in the last column, column by column (Open3D, Eigen) in the last row; the other
    place holds zeros, which is how the two are distinguished.

    Raises:
        CaptureError: another count, or numbers that are a camera matrix in neither order.
    """
    try:
        flat = table_of(values).ravel()
    except (TypeError, ValueError) as error:
        raise CaptureError("the camera matrix is not made of numbers", file=source, found=str(error)) from error
    if flat.size == 16:
        M = flat.reshape(4, 4)  # a 3x3 matrix in the corner of the identity, as ScanNet writes it
        padded = np.array_equal(M[3], [0, 0, 0, 1]) and np.array_equal(M[:, 3], [0, 0, 0, 1])
        flat = M[:3, :3].ravel() if padded else flat
    if flat.size != 9 or not np.isfinite(flat).all():
        raise CaptureError(
            "a camera matrix that is not nine finite numbers", file=source, found=" ".join(f"{v:g}" for v in flat[:16])
        )
    M = flat.reshape(3, 3)
    principal_last_column = bool(M[0, 2] or M[1, 2])
    principal_last_row = bool(M[2, 0] or M[2, 1])
    if principal_last_column == principal_last_row or M[0, 0] <= 0 or M[1, 1] == 0 or M[2, 2] != 1:
        raise CaptureError(
            "not a camera matrix",
            file=source,
            expected="fx 0 cx, 0 fy cy, 0 0 1, row by row or column by column",
            found=" ".join(f"{v:g}" for v in flat),
        )
    K, order = (M, "row by row") if principal_last_column else (M.T, "column by column")
    skew = abs(K[0, 1]) + abs(K[1, 0])
    if skew > 1e-3 * K[0, 0]:
        raise CaptureError("a camera with skew is not supported", file=source, found=f"skew {skew:g}")
    return K, order


def _of_matrix(values: ArrayLike, source: Path) -> tuple[list[float], tuple[str]]:
    """fx fy cx cy, and the note about how the matrix is written."""
    K, order = camera_matrix(values, source)
    return K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), (f"{source.name}: the camera matrix is written {order}",)


def check(camera: Intrinsics, source: Path) -> Intrinsics:
    """The camera itself if it can exist.

    Raises:
        CaptureError: lengths not positive, principal point outside the image, or an impossible field of view.
    """
    c = camera
    expected = found = None
    if not all(np.isfinite([c.fx, c.fy, c.cx, c.cy])) or min(c.fx, c.fy, c.width, c.height) <= 0:
        expected, found = "positive, finite figures", f"fx {c.fx} fy {c.fy} cx {c.cx} cy {c.cy} {c.width}x{c.height}"
    elif not (0 < c.cx < c.width and 0 < c.cy < c.height):
        expected, found = f"a principal point inside {c.width}x{c.height}", f"({c.cx:g}, {c.cy:g})"
    elif not 0.5 < c.fx / c.fy < 2:
        expected, found = "fx and fy of similar size", f"fx {c.fx:g}, fy {c.fy:g}"
    else:
        fov = float(np.degrees(2 * np.arctan(c.width / (2 * c.fx))))
        if not FIELD_OF_VIEW_DEG[0] < fov < FIELD_OF_VIEW_DEG[1]:
            expected, found = "a field of view of 5 to 170 degrees", f"{fov:.1f} degrees (fx {c.fx:g})"
    if found is not None:
        raise CaptureError(
            "these intrinsics cannot belong to the images",
            file=source,
            expected=expected,
            found=found,
            hint="intrinsics are in pixels of the images as they are in the folder",
        )
    return camera


def off_centre(camera: Intrinsics) -> float:
    """How far the principal point lies off the middle, over the image's size."""
    return max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))


def read_camera(path: Path) -> Camera:
    """The camera in a .json, .yaml/.yml or .txt file (keys: docs/captures.md).

    Raises:
        CaptureError: unreadable, or without camera parameters.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        return camera_from_mapping(read_json(path), path).y_down()
    if suffix in (".yaml", ".yml"):
        return camera_from_mapping(read_opencv_yaml(path), path).y_down()
    return camera_from_text(read_text(path, 2**20), path).y_down()


def read_opencv_yaml(path: Path) -> Any:
    """Parsed YAML; OpenCV starts it with a directive and tags matrices, neither of which plain YAML knows."""
    return parse_yaml(re.sub(r"^%YAML.*$|!!opencv-matrix", "", read_text(path, 2**20), flags=re.MULTILINE), path)


def camera_from_mapping(data: Any, source: Path) -> Camera:
    """A camera from parsed JSON or YAML: a matrix, or fx fy cx cy (also fl_x, ppx, ORB-SLAM's Camera.fx or Camera1.fx),
    perhaps one level down."""
    if not isinstance(data, Mapping):
        raise _no_camera(source, "a list or a single value")
    data = {re.sub(r"^(Camera1?|RGBD)\.", "", str(key)): value for key, value in data.items()}
    for inner in ("intrinsics", "intrinsic", "camera", "depth", "depth_intrinsics", "depth_camera"):
        if isinstance(data.get(inner), Mapping) and (_separate(data[inner]) or _matrix(data[inner])) is not None:
            return camera_from_mapping({**data, inner: None, **data[inner]}, source)
    notes: tuple[str, ...] = ()
    separate, matrix = _separate(data), _matrix(data)
    if separate is not None:
        fx, fy, cx, cy = (_number(v, source) for v in separate)
    elif matrix is not None:
        (fx, fy, cx, cy), notes = _of_matrix(matrix, source)
    else:
        raise _no_camera(source, f"the keys {', '.join(map(str, data))}")
    unit, unit_notes = _depth_unit(data, source)
    given = _first(data, WIDTH_KEYS), _first(data, HEIGHT_KEYS)
    width, height = (None, None) if None in given else (_pixels(v, source) for v in given)
    warnings = _distortion_warning(data, source)
    return Camera(fx, fy, cx, cy, width, height, source, notes + unit_notes, warnings, unit)


def camera_from_text(text: str, source: Path) -> Camera:
    """A camera from a text file: a 3x3 or 4x4 matrix, or one line `fx fy cx cy [width height]`; # starts a comment. Or
    the colour camera of the `name = value` lines that BundleFusion's reader of .sens files leaves."""
    named = dict(re.findall(r"^(m_\w+) *= *(.+)$", text, flags=re.MULTILINE))
    if "m_calibrationColorIntrinsic" in named:
        camera = camera_from_text(named["m_calibrationColorIntrinsic"], source)
        width, height, steps = (named.get(f"m_{key}", "0") for key in ("colorWidth", "colorHeight", "depthShift"))
        if width.isdigit() and height.isdigit() and steps.isdigit() and min(map(int, (width, height, steps))) > 0:
            return replace(camera, width=int(width), height=int(height), depth_unit=1 / int(steps))
        return camera
    words = " ".join(line.split("#")[0] for line in text.splitlines()).replace(",", " ").split()
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise _no_camera(source, str(error)) from error
    if len(values) in (4, 6):
        fx, fy, cx, cy = values[:4]
        width, height = (_pixels(v, source) for v in values[4:]) if len(values) == 6 else (None, None)
        return Camera(fx, fy, cx, cy, width, height, source)
    if len(values) in (9, 16):
        (fx, fy, cx, cy), notes = _of_matrix(values, source)
        return Camera(fx, fy, cx, cy, None, None, source, notes)
    raise _no_camera(source, f"{len(values)} numbers")


CAMERA_TEXT = {
    ".txt": "one line `fx fy cx cy width height`",
    ".json": '`{"fx": ..., "fy": ..., "cx": ..., "cy": ..., "width": ..., "height": ...}`',
    ".csv": "the 3x3 camera matrix, a row a line",
}
"""How a camera is written into a file of each kind."""


def no_intrinsics(folder: Path, looked_for: Sequence[str], hint: str | None = None) -> CaptureError:
    """The error for a capture without intrinsics; the way out is `hint`, or what to write into which file."""
    name = next((n for n in looked_for if n.endswith(".txt")), looked_for[0])
    way_out = hint or f"write the camera into {name} in this folder: {CAMERA_TEXT[Path(name).suffix]}"
    return CaptureError("no intrinsics", file=folder, expected=f"one of {', '.join(looked_for)}", hint=way_out)


def _no_camera(source: Path, found: str) -> CaptureError:
    return CaptureError(
        "no camera parameters in this file",
        file=source,
        expected="fx fy cx cy, or a 3x3 camera matrix",
        found=found,
    )


def _separate(data: Mapping) -> tuple | None:
    for names in (("fx", "fy", "cx", "cy"), ("fl_x", "fl_y", "cx", "cy"), ("fx", "fy", "ppx", "ppy")):
        if all(name in data for name in names):
            return tuple(data[name] for name in names)
    return None


def _matrix(data: Mapping) -> Any | None:
    value = _first(data, MATRIX_KEYS)
    return value.get("data") if isinstance(value, Mapping) else value


def _first(data: Mapping, keys: Sequence[str]) -> Any | None:
    return next((data[key] for key in keys if data.get(key) is not None), None)


def _number(value: Any, source: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise CaptureError("a camera parameter is not a number", file=source, found=reprlib.repr(value))
    try:
        return float(value)
    except OverflowError as error:
        raise CaptureError("a camera parameter is not a usual number", file=source, found=str(error)) from error


def _pixels(value: Any, source: Path) -> int:
    """A width or height."""
    number = _number(value, source)
    if number <= 0 or not number.is_integer():
        raise CaptureError("the image size is not a number of pixels", file=source, found=f"{number:g}")
    return int(number)


def _depth_unit(data: Mapping, source: Path) -> tuple[float | None, tuple[str, ...]]:
    """Metres a step; files say either `0.001` (metres a step) or `1000` (steps a metre), which cannot be confused."""
    value = _first(data, DEPTH_UNIT_KEYS)
    if value is None:
        return None, ()
    number = _number(value, source)
    if number <= 0:
        raise CaptureError("the depth unit is not positive", file=source, found=str(value))
    unit = number if number < 1 else 1.0 / number
    return unit, (f"{source.name}: depth unit {number:g} means {unit:g} m a step",)


def _distortion_warning(data: Mapping, source: Path) -> tuple[str, ...]:
    """Lens distortion is not corrected here; a warning is given if a file specifies any."""
    value = _first(data, ("distortion_coefficients", "dist_coeffs", "distortion", "coeffs"))
    value = value.get("data") if isinstance(value, Mapping) else value
    if value is None:
        value = [data.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3", "k4")]
    if not isinstance(value, Sequence) or isinstance(value, str):
        return ()
    figures = [v for v in value if isinstance(v, (int, float))]
    if not any(figures):
        return ()
    return (f"{source.name} gives lens distortion {figures}: it is not undone, rectify the images first if it matters",)
