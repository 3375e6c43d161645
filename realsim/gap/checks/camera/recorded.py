"""Depth frames of a log: the arrays `depth_time` (N,) and `depth` (N, h, w) of a run, or a folder of images beside it,
and the camera in log.json.

    "depth_camera": {"camera": "head", "fx": 21.6, "fy": 21.6, "cx": 15.5, "cy": 11.5, "noise": [0.002, 0, 0.002]}

`camera` is a camera of model.xml (MuJoCo's axes: it looks along -z, y up); its field of view is not used. Depth is
along the optical axis, in m (float) or mm (16-bit); 0 and NaN are no measurement.

The frames of runs/NAME.npz or NAME.csv may stand in runs/NAME_depth/: 16-bit .png (mm) or .npy, with depth.txt, a line
"seconds file" for each on the run's clock, as in the TUM RGB-D sets (Sturm et al. 2012). Only those looked at are read.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, did_you_mean, require
from realsim.core.files import check_size, inside, read_json, read_npz, read_text
from realsim.core.types import F64
from realsim.gap.case.case import Case

EXAMPLE = (
    '"depth_camera": {"camera": "head", "fx": 320, "fy": 320, "cx": 319.5, "cy": 239.5, "noise": [0.002, 0, 0.002]}'
)
MAX_BYTES = 2 * 2**30
FAR = 6.0


@dataclass(frozen=True)
class DepthCamera:
    """The camera as the operator believes in it."""

    name: str
    fx: float
    fy: float
    cx: float
    cy: float
    noise: tuple[float, float, float] | None
    """m, 1, 1/m: its standard deviation at depth z is a + b z + c z^2; None where it is not known."""
    far: float = FAR
    """m beyond which it measures nothing."""

    def sigma(self, z: F64) -> F64:
        """m of noise at a depth."""
        a, b, c = self.noise or (0.003, 0.0, 0.002)
        return a + b * z + c * z * z


@dataclass(frozen=True)
class Frames:
    """The depth of one run, thinned to what is looked at."""

    run: int
    time: F64
    """(N,) s, the log's."""
    depth: F64
    """(N, P) m at the P pixels that are looked at; 0 where nothing was measured."""


def depth_camera(case: Case) -> DepthCamera | None:
    """The camera of log.json, or None where there is none. Raises GapError for one that cannot be read."""
    file = case.folder / "log.json"
    given = read_json(file).get("depth_camera") if file.is_file() else None
    if given is None:
        return None
    try:
        noise = given.get("noise")
        fx, fy, cx, cy = (float(given[k]) for k in ("fx", "fy", "cx", "cy"))
        found = DepthCamera(
            str(given["camera"]), fx, fy, cx, cy,
            None if noise is None else (float(noise[0]), float(noise[1]), float(noise[2])),
            float(given.get("far", FAR)),
        )  # fmt: skip
        if not (found.fx > 0 and found.fy > 0 and found.far > 0 and (noise is None or found.sigma(np.ones(1))[0] > 0)):
            raise ValueError(given)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise GapError(
            "depth_camera of log.json cannot be read", file=file, expected=EXAMPLE, found=repr(given)[:120]
        ) from error
    known = [case.model.camera(i).name for i in range(case.model.ncam)]
    if found.name not in known:
        raise GapError(
            f"the depth camera {found.name!r} is not in model.xml", file=file,
            expected=f"one of {', '.join(known)}" if known else "a <camera> on the robot, where its optical centre is",
            hint=did_you_mean(found.name, known),
        )  # fmt: skip
    return found


def read_frames(case: Case, camera: DepthCamera, most: int, pixels: int) -> tuple[list[Frames], F64]:
    """(frames of every run that has some, (P, 3) directions of their pixels with z = 1, OpenCV's axes).

    At most about `most` frames in all, evenly spread, on a grid of about `pixels` pixels.

    Raises:
        GapError: arrays of other shapes, or none in any run.
    """
    found: list[Frames] = []
    rays: F64 | None = None
    shape: tuple[int, ...] = ()
    share = max(1, most // max(len(case.runs), 1))
    for r, run in enumerate(case.runs):
        recorded = recorded_frames(case.folder / "runs", run.name)
        if recorded is None:
            continue
        path, time, read = recorded
        pick = np.unique(np.linspace(0, len(time) - 1, min(share, len(time))).round().astype(int))
        depth = in_metres(read(pick))
        shape = shape or depth.shape[1:]
        if depth.shape[1:] != shape:
            raise GapError(
                "depth frames of different sizes", file=path, expected=str(shape), found=str(depth.shape[1:])
            )
        step = max(1, int(np.ceil(np.sqrt(shape[0] * shape[1] / pixels))))
        metres = depth[:, ::step, ::step]
        metres = np.where(np.isfinite(metres) & (metres > 0) & (metres <= camera.far), metres, 0.0)
        found.append(Frames(r, time[pick], metres.reshape(len(pick), -1)))
        v, u = np.mgrid[0 : shape[0] : step, 0 : shape[1] : step]
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], -1).reshape(-1, 3)
    if rays is None:
        raise GapError(
            "log.json has a depth_camera and no run has depth", file=case.folder / "runs",
            expected="arrays depth_time (N,) and depth (N, h, w) in runs/*.npz, or images in runs/NAME_depth/",
        )  # fmt: skip
    return found, rays


def in_metres(depth: Any) -> F64:
    """Depth as recorded, whole numbers of mm or m."""
    return np.asarray(depth, dtype=np.float64) * (1e-3 if depth.dtype.kind in "ui" else 1.0)


def recorded_frames(runs: Path, name: str) -> tuple[Path, F64, Callable[[Any], Any]] | None:
    """(file, (N,) s, a function of indices (K,) -> (K, h, w) as recorded) of one run; None where it has no frames.

    Raises:
        GapError: frames that cannot be read, or a clock that does not increase.
    """
    folder, path = runs / f"{name}_depth", runs / f"{name}.npz"
    arrays = _arrays(path)
    if folder.is_dir() and arrays is not None:
        raise GapError(
            "a run has depth frames twice", file=folder, expected="the folder, or arrays in the .npz", found="both"
        )
    if folder.is_dir():
        path = folder / "depth.txt"
        time, files = _listed(path)
    elif arrays is not None:
        time, depth = arrays
    else:
        return None
    if not len(time):
        raise GapError("no depth frame is listed", file=path, expected='"seconds file" on each line')
    if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise GapError("the camera's clock does not increase", file=path, expected="increasing times")
    return path, time, lambda pick: _stack([files[k] for k in pick]) if arrays is None else depth[pick]


def _listed(listing: Path) -> tuple[F64, list[Path]]:
    """Times and files of depth.txt."""
    if not listing.is_file():
        raise GapError(
            "the depth frames have no times", file=listing.parent, expected='depth.txt, "seconds file" on each line'
        )
    times, files = [], []
    for number, line in enumerate(read_text(listing).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            seconds, file = float(words[0]), inside(listing.parent, words[1])
        except (IndexError, ValueError) as error:
            raise GapError(
                f"line {number} cannot be read", file=listing, expected="0.100 0001.png", found=line[:60]
            ) from error
        if not file.is_file():
            raise GapError(f"line {number} names a file that is not there", file=listing, found=words[1])
        times.append(seconds)
        files.append(file)
    return np.array(times), files


def _stack(files: list[Path]) -> Any:
    frames = [_frame(file) for file in files]
    for file, frame in zip(files, frames, strict=True):
        if frame.shape != frames[0].shape or frame.dtype.kind != frames[0].dtype.kind:
            raise GapError(
                "depth frames of different sizes or kinds", file=file, expected=f"{frames[0].shape} {frames[0].dtype}",
                found=f"{frame.shape} {frame.dtype}",
            )  # fmt: skip
    return np.stack(frames)


def _frame(file: Path) -> Any:
    """(h, w) of one image."""
    check_size(file, MAX_BYTES)
    image: Any = None
    if file.suffix == ".npy":
        try:
            image = np.load(file, allow_pickle=False)
        except (ValueError, OSError, EOFError) as error:
            raise GapError("the depth frame is damaged", file=file, found=str(error)[:80]) from error
    else:
        require("recon", "reading depth images")
        import cv2

        data = np.fromfile(file, np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    good = image is not None and image.ndim == 2 and (image.dtype.kind == "f" or image.dtype == np.uint16)
    if not good:
        raise GapError(
            "not a depth frame", file=file, expected="16-bit .png in mm, or .npy (h, w) in m or 16-bit mm",
            found="nothing that can be read" if image is None else f"{image.shape} {image.dtype}",
        )  # fmt: skip
    return image


def _arrays(path: Path) -> tuple[F64, Any] | None:
    """(N,) s and (N, h, w) of an .npz; None where it has neither."""
    if not path.is_file():
        return None
    check_size(path, MAX_BYTES)
    data = read_npz(path)
    if "depth" not in data and "depth_time" not in data:
        return None
    time, depth = (data.get(name, np.zeros(0)) for name in ("depth_time", "depth"))
    if (
        depth.ndim != 3
        or time.shape != depth.shape[:1]
        or depth.dtype.kind not in "uif"
        or time.dtype.kind not in "uif"
    ):
        raise GapError(
            "depth frames cannot be read", file=path, expected="depth_time (N,) in s and depth (N, h, w)",
            found=f"{time.shape} and {depth.shape}",
        )  # fmt: skip
    return time.astype(np.float64), depth
