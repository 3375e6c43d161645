"""Delay, mount and noise of a depth camera, from what it recorded and what it should have seen.

The base's pose errs in each run by a little, which moves the camera like a wrong mount does in this run alone; so each
run has a shift and a turn of its own, with a prior; a part of it all runs share, which only its prior tells from the
camera's mount; and each frame's pose errs by itself. Residuals are clipped, and slopes are taken over steps as large as
what is looked for: at the edge of a stake a pixel sees either side.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from math import degrees
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.least_squares import Minimum, least_squares
from realsim.core.statistics import Z90, Interval
from realsim.core.types import F64
from realsim.gap.case.case import Case, Run
from realsim.gap.checks.camera.mixed import EVIDENCE, bayes
from realsim.gap.checks.camera.rays import Correction, Mount, View
from realsim.gap.checks.camera.recorded import DepthCamera, depth_camera, read_frames
from realsim.gap.checks.camera.terrain import Terrain
from realsim.gap.effects.camera import CAMERA_DELAY as DELAY
from realsim.gap.effects.camera import CAMERA_MOUNT as MOUNT
from realsim.gap.effects.camera import DEPTH_NOISE as NOISE

FRAMES, PIXELS = 60, 800
CLIP = 0.06
"""m beyond which a pixel saw something else."""
FREEDOM = 4.0
"""Degrees of freedom of the residuals."""
LENGTHS = (0.5, 1.0, 2.0, 4.0)
"""Multiples of a step that are tried: at edges slopes are small, so that steps fall short."""
STEPS = np.array([0.02, *[0.006] * 3, *[0.006] * 3])
"""s, rad and m over which slopes are taken."""
EVERYDAY = np.array([0.004, *[0.0035] * 3, *[0.0015] * 3])
"""s, rad and m that any camera is late, turned and displaced by: its exposure and a good calibration."""
WIDE = np.array([0.1, *[0.05] * 3, *[0.03] * 3])
OF_RUN = np.array([0.01, 0.01, 0.03, 0.01, 0.01, 0.01])
"""m and rad by which the base's pose is off in a run, where nothing is known of it."""
OF_RUN_BY_FEET = np.array([0.006, 0.006, 0.0003, 0.0005, 0.0005, 0.01])
"""The same where feet on the scene have told its height and lean."""
OF_ALL = np.array([1e-5, 1e-5, 0.0007, 0.0033, 0.0033, 1e-5])
"""m and rad by which height and lean are off alike in all runs: feet tell them by the same legs, on the same tops, in
the same gait, and an IMU sits as askew in each. More crossings do not tell it from a turned camera. This and the line
above: measured against the true pose on terrains 60 to 71 of tests/truths/crossings.py (0.22 and 0.15 degrees in
common, 0.03 and 0.02 of each run)."""
NOISIER = 1.3
"""Ratio beyond which, with its interval, noise is more than the everyday spread of such cameras."""
SCAN = 0.002
"""m by which a scan is off here and there: pixels that lie side by side err together by it."""
STEADY = 1e-5
"""m and rad by which any pose errs, also where the log is smooth or has none."""
STRAIGHT = 1e-9
"""m by which a sample is off the line between its neighbours where it was not interpolated."""
LEAST_BENDS = 20
LEAST_PIXELS = 500
KINDS = (
    (DELAY.name, (0,)),
    *((MOUNT.name, (k,)) for k in range(1, 7)),
    (MOUNT.name, (1, 2, 3)),
    (MOUNT.name, (4, 5, 6)),
)
"""Effect and parameters that are compared with everyday deviations: alone, and together where data know only a mix."""


AXES = "xyz"
"""Of the camera: right, down, forward."""
PARAMETERS = {
    DELAY.name: {"delay": "s"},
    MOUNT.name: {f"{what}_{axis}": unit for axis in AXES for what, unit in (("turn", "rad"), ("shift", "m"))},
    NOISE.name: {"ratio": "ratio"},
}
"""Effect -> its parameters with their units: turns about the camera's axes, shifts along them, and the noise as a ratio
to what log.json says."""


@dataclass(frozen=True)
class CameraFound:
    """What recorded depth says of its camera."""

    camera: str
    quantities: dict[str, Interval]
    """Parameter -> its value; without `ratio` where log.json says nothing of noise."""
    named: dict[str, float]
    """Effect -> its log-odds, of those beyond everyday deviations."""
    before: float
    after: float
    """m, median size of the residual with the mount as given, and as found."""
    frames: int
    pixels: int
    notes: tuple[str, ...] = field(default=())

    def along(self, what: str) -> list[Interval]:
        """`turn` or `shift` for each axis."""
        return [self.quantities[f"{what}_{axis}"] for axis in AXES]

    def causes(self) -> list[dict[str, Any]]:
        """The effects that were named, in the form of diagnosis.json."""
        return [
            {"effect": name, "parameters": {k: self.quantities[k].as_dict() for k in PARAMETERS[name]},
             "probability": None}
            for name in self.named
        ]  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        def listed(q: Interval | None) -> list[float] | None:
            return None if q is None else [q.value, q.low, q.high]

        return {
            "camera": self.camera, "named": self.named, "delay_s": listed(self.quantities["delay"]),
            "turn_rad": list(map(listed, self.along("turn"))), "shift_m": list(map(listed, self.along("shift"))),
            "noise_ratio": listed(self.quantities.get("ratio")), "residual_before_m": self.before,
            "residual_after_m": self.after, "frames": self.frames, "pixels": self.pixels, "notes": list(self.notes),
        }  # fmt: skip

    def sentences(self) -> list[str]:
        """What is beyond everyday, a sentence each."""
        found = []
        if DELAY.name in self.named:
            found.append(f"the camera {self.camera} is late by {self.quantities['delay'].text('.0f', 1e3, ' ms')}")
        if MOUNT.name in self.named:
            turn = ", ".join(q.text("+.1f", degrees(1), "°") for q in self.along("turn"))
            shift = ", ".join(q.text("+.0f", 1e3) for q in self.along("shift"))
            found.append(
                f"the camera {self.camera} is not mounted as in the model: turned by {turn} and shifted by {shift} mm "
                "(about and along right, down, forward)"
            )
        if NOISE.name in self.named:
            times = self.quantities["ratio"].text(".1f")
            found.append(f"the depth of {self.camera} is {times} times as noisy as log.json says")
        return found


def calibrate(
    case: Case,
    terrain: Terrain,
    correction: Correction | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> CameraFound | None:
    """Delay, mount and noise of the log's depth camera; None where log.json names none.

    Args:
        correction: of the base's pose, from feet on the scene (`FootholdMap.correction`).

    Raises:
        GapError: frames that cannot be read, or that never look at the scene.
    """
    camera = depth_camera(case)
    if camera is None:
        return None
    frames, rays = read_frames(case, camera, FRAMES, PIXELS)
    view = View(case, terrain, camera, frames, rays, correction)
    return _Fitter(view, camera, OF_RUN if correction is None else OF_RUN_BY_FEET).found(
        case, progress or (lambda what, share: None)
    )


LIKE = 20.0
"""Pixels side by side err together where the scan does: as many count as one. From the spacing of pixels on a top,
looked at on terrains 0 and 1 of tests/truths/crossings.py."""


def students_t(residual: F64) -> tuple[float, F64]:
    """The loss of pixels; see FREEDOM and LIKE."""
    s = residual**2 / FREEDOM
    size = (FREEDOM + 1) / LIKE
    return size * float(np.log1p(s).sum()), size / FREEDOM / (1 + s)


class _Fitter:
    """Unknowns: the camera's 7 (delay, turn, shift), then of the base's pose 6 (shift, turn) that all runs share, 6 a
    run, and 6 a frame."""

    def __init__(self, view: View, camera: DepthCamera, of_run: F64) -> None:
        self.view, self.camera = view, camera
        self.runs = len(view.frames)
        self.own = 13 + 6 * self.runs
        """Unknowns before those of frames."""
        counts = [len(f.time) for f in view.frames]
        self.first = self.own + 6 * np.cumsum([0, *counts])
        """Of each run: its frames' first unknown."""
        of_frames = [np.tile(jitter(view.case.runs[f.run]), n) for f, n in zip(view.frames, counts, strict=True)]
        self.prior = np.concatenate([WIDE, OF_ALL, np.tile(of_run, self.runs), *of_frames])
        self.use = [(f.depth > 0) & ~hidden for f, hidden in zip(view.frames, view.hidden, strict=True)]
        self.sigma = np.concatenate([np.hypot(camera.sigma(f.depth), SCAN).ravel() for f in view.frames])

    def offsets(self, x: F64, which: int) -> F64:
        """(N, 6) m and rad by which the base is off in each frame of a run."""
        of_frames = x[self.first[which] : self.first[which + 1]].reshape(-1, 6)
        return x[7:13] + x[13 + 6 * which : 19 + 6 * which] + of_frames

    def predicted(self, x: F64, which: int) -> tuple[F64, Any]:
        """Depth and geoms of one run's frames."""
        return self.view.depth(which, Mount(float(x[0]), x[1:4], x[4:7]), self.offsets(x, which))

    def residual(self, x: F64) -> F64:
        """(M,) m of all pixels, recorded less predicted, clipped; NaN where either is missing, or the robot is seen."""
        found = []
        for which, use in enumerate(self.use):
            z, _ = self.predicted(x, which)
            r = np.clip(self.view.frames[which].depth - z, -CLIP, CLIP)
            found.append(np.where(use & (z > 0), r, np.nan).ravel())
        return np.concatenate(found)

    def model(self, x: F64) -> tuple[F64, Callable[[], Any]]:
        """Residuals in standard deviations, and their Jacobian."""

        from scipy import sparse

        def jacobian() -> Any:
            columns = []
            for k, step in enumerate(STEPS):
                side = 0.5 * step * (np.arange(len(x)) == k)
                columns.append((self.residual(x + side) - self.residual(x - side)) / step)
            J = np.stack(columns, axis=1) / self.sigma[:, None]
            J = np.where(np.isfinite(J).all(axis=1)[:, None], J, 0.0)
            base = [part for which in range(self.runs) for part in self._of_base(J, x, which)]
            runs = np.split(np.arange(len(base)), np.cumsum([len(f.time) for f in self.view.frames])[:-1])
            of_runs = sparse.block_diag([np.vstack([base[n] for n in run]) for run in runs])
            return sparse.hstack([J, np.vstack(base), of_runs, sparse.block_diag(base)]).tocsr()

        return self.residual(x) / self.sigma, jacobian

    def found(self, case: Case, tick: Callable[[str, float], None]) -> CameraFound:
        nothing = np.zeros(len(self.prior))
        before = self.residual(nothing)
        total = int(np.isfinite(before).sum())
        if total < LEAST_PIXELS:
            raise GapError(
                "the depth camera never looks at the scene", file=case.folder,
                expected=f"at least {LEAST_PIXELS} pixels with depth of it", found=str(total),
                hint="is base_pos in the scene's frame, and the camera of model.xml where the real one is?",
            )  # fmt: skip
        tick("camera", 0.7)
        fit = least_squares(
            self.model, nothing, loss=students_t, prior=(nothing, self.prior), lengths=LENGTHS, iterations=20,
            tolerance=1e-4, least_gain=1e-4,
        )  # fmt: skip
        assert fit is not None  # no state is impossible
        covariance = self._covariance(fit)
        named: dict[str, float] = {}
        for name, which in KINDS:
            at = list(which)
            gain = bayes(fit.state[at], covariance[np.ix_(at, at)], self.prior[at], EVERYDAY[at])
            odds = -gain - float(np.log(len(KINDS) + 1))
            if odds > EVIDENCE:
                named[name] = max(odds, named.get(name, 0.0))
        half = Z90 * np.sqrt(np.diag(covariance))
        units = PARAMETERS[DELAY.name] | {
            f"{what}_{a}": u for what, u in (("turn", "rad"), ("shift", "m")) for a in AXES
        }
        quantities = {
            name: Interval(float(v), float(v - h), float(v + h), unit)
            for (name, unit), v, h in zip(units.items(), fit.state[:7], half[:7], strict=True)
        }
        noise = self._noise(fit.state)
        if noise is not None:
            quantities["ratio"] = noise
            if noise.low > NOISIER:
                spread = max((noise.high - noise.low) / 3.3, 1e-3)
                named[NOISE.name] = float(min(30.0, np.log(noise.value) ** 2 / spread**2))
        notes = []
        if self.runs < 3:
            notes.append("fewer than three runs have depth: a lean of the base in a run looks like a turned mount")
        sizes = [float(np.nanmedian(np.abs(r))) for r in (before, self.residual(fit.state))]
        count = sum(len(f.time) for f in self.view.frames)
        return CameraFound(self.camera.name, quantities, named, sizes[0], sizes[1], count, total, tuple(notes))

    def _of_base(self, J: F64, x: F64, which: int) -> list[F64]:
        """(P, 6) of each frame of a run: slopes of residuals by a shift and a turn of the base in the world's axes,
        from those of all pixels (M, 7) in the camera's axes.

        Taken by simulation too, they would differ by a little from what they are: the same, in other axes; and what no
        data tell apart but priors would be distinguished by that.
        """
        frames = self.view.frames[which]
        start = sum(f.depth.size for f in self.view.frames[:which])
        found = []
        slopes_of = J[start : start + frames.depth.size].reshape(len(frames.time), -1, 7)
        mount = Mount(float(x[0]), x[1:4], x[4:7])
        for slopes, R in zip(slopes_of, self.view.poses(which, mount, self.offsets(x, which))[1], strict=True):
            found.append(np.hstack([slopes[:, 4:7] @ R.T, slopes[:, 1:4] @ R.T]))
        return found

    def _covariance(self, fit: Minimum[F64]) -> F64:
        """Of all unknowns but the frames': by curvature, and where there are runs enough, by how these disagree."""
        inverse = np.linalg.inv(fit.information.toarray() + np.diag(self.prior**-2.0))[: self.own, : self.own]
        if self.runs < 4:
            return inverse
        pull = fit.jacobian[:, : self.own].multiply((fit.weight * fit.residual)[:, None]).tocsr()
        ends = np.cumsum([0, *(f.depth.size for f in self.view.frames)])
        scores = np.stack([np.asarray(pull[a:b].sum(axis=0)).ravel() for a, b in pairwise(ends)])
        return np.asarray(inverse + inverse @ scores.T @ scores @ inverse * self.runs / (self.runs - 1))

    def _noise(self, x: F64) -> Interval | None:
        """Ratio of the noise to what log.json says, from second differences along rows on one geom: these know
        neither the scan's errors nor the mount's. None where log.json says nothing."""
        if self.camera.noise is None:
            return None
        ratios = []
        width = int(np.flatnonzero(np.diff(self.view.rays[:, 1]) != 0)[0]) + 1  # columns of the grid of pixels
        for w, frames in enumerate(self.view.frames):
            z, geom = self.predicted(x, w)
            r = (frames.depth - z).reshape(len(z), -1, width)
            use = (self.use[w] & (z > 0) & (np.abs(frames.depth - z) < CLIP)).reshape(r.shape)
            same, z = geom.reshape(r.shape), z.reshape(r.shape)
            flat = use[..., :-2] & use[..., 1:-1] & use[..., 2:]
            flat &= (same[..., :-2] == same[..., 1:-1]) & (same[..., 2:] == same[..., 1:-1])
            change = r[..., 1:-1] - 0.5 * (r[..., :-2] + r[..., 2:])
            ratios.append(np.abs(change[flat]) / (np.sqrt(1.5) * self.camera.sigma(z[..., 1:-1][flat])))
        every = np.concatenate(ratios)
        if len(every) < LEAST_PIXELS:
            return None
        value = float(np.median(every) / 0.6745)
        by_run = np.array([np.median(v) / 0.6745 for v in ratios if len(v) > 50])
        spread = float(np.std(by_run, ddof=1) / np.sqrt(len(by_run))) if len(by_run) > 2 else 0.0
        half = Z90 * float(np.hypot(spread, 1.17 * value / np.sqrt(len(every))))
        return Interval(value, value - half, value + half, "ratio")


def jitter(run: Run) -> F64:
    """(6,) m and rad by which a logged pose of the base errs by itself, world axes: by second differences.

    Samples that lie straight between their neighbours were put there from slower ones: they err with these.
    """
    from scipy.spatial.transform import Rotation

    found = np.full(6, STEADY)
    pos, quat = run.signals.get("base_pos"), run.signals.get("base_quat")
    if pos is None or quat is None:
        return found
    good = np.isfinite(pos).all(axis=1) & np.isfinite(quat).all(axis=1)
    pos, quat = pos[good], quat[good]
    bent = np.flatnonzero((np.abs(np.diff(pos, n=2, axis=0)) > STRAIGHT).any(axis=1)) + 1
    if len(bent) < LEAST_BENDS:
        return found
    turn = Rotation.from_quat(quat[bent], scalar_first=True)
    turned = (turn[1:] * turn[:-1].inv()).as_rotvec()
    for k, second in enumerate((np.diff(pos[bent], n=2, axis=0), np.diff(turned, axis=0))):
        found[3 * k : 3 * k + 3] += np.median(np.abs(second), axis=0) / 0.6745 / np.sqrt(6.0)
    return found
