"""Simulation cost of a representation: steps of G1 standing and stepping on it, relative to a plane."""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.export.contact.probe import terrain_only

STEPS = 200
REPEATS = 5


def step_cost(spec: Any, place: NDArray[np.float64]) -> dict[str, float]:
    """Time of a step with G1 at `place` (3,) metres (the ground under its feet), as a multiple of that on a plane.

    Time of the processor, not of the clock; plane and terrain take turns and the fastest of five runs counts, so that
    other work on the machine drops out of the ratio as far as it can.

    Returns:
        `step_cost_vs_plane` (standing), `walk_cost_vs_plane` (stepping in place), `steps_per_second` (standing),
        `contacts` (mean while standing).
    """
    import mujoco

    plane = mujoco.MjSpec()
    plane.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    models = [with_g1(plane, np.zeros(3)), with_g1(terrain_only(spec), place)]
    stand, walk = (np.array([[_run(m, swing) for m in models] for _ in range(REPEATS)]).min(0) for swing in (0.0, 0.25))
    return {
        "step_cost_vs_plane": round(float(stand[1, 0] / stand[0, 0]), 3),
        "walk_cost_vs_plane": round(float(walk[1, 0] / walk[0, 0]), 3),
        "steps_per_second": round(float(STEPS / stand[1, 0])),
        "contacts": round(float(stand[1, 1]), 1),  # the same in every repeat
    }


def with_g1(spec: Any, place: NDArray[np.float64]) -> Any:
    """The model of a terrain with G1 standing at `place` (3,) metres."""
    from realsim.robots.g1 import g1

    spec.attach(g1().placed(place).spec, frame=spec.worldbody.add_frame(), prefix="g1/")
    return spec.compile()


def _run(model: Any, swing: float) -> tuple[float, float]:
    """(seconds, mean contacts) of STEPS steps from standing; hips, knees and ankles swing by `swing` radians, left
    and right in turn."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    home = data.ctrl.copy()
    pattern = np.zeros(model.nu)
    for side, sign in (("left", 1), ("right", -1)):
        for joint, part in (("hip_pitch", -1), ("knee", 2), ("ankle_pitch", -1)):
            pattern[model.actuator(f"g1/{side}_{joint}_joint").id] = sign * part
    contacts = 0
    began = time.thread_time()
    for step in range(STEPS):
        if swing:
            data.ctrl[:] = home + swing * np.sin(2 * np.pi * step * model.opt.timestep / 0.5) * pattern
        mujoco.mj_step(model, data)
        contacts += data.ncon
    return time.thread_time() - began, contacts / STEPS


def standing_place(xyz: NDArray[np.float64], radius: float = 0.2) -> NDArray[np.float64]:
    """The highest of the points (N, 3) about which the terrain is level to 1 cm within `radius` metres; where none
    is, the most level one."""
    from scipy.spatial import cKDTree

    tree = cKDTree(xyz[:, :2])
    ranges = np.array([np.ptp(xyz[near, 2]) for near in tree.query_ball_point(xyz[:, :2], radius)])
    lower, upper = xyz.min(0)[:2] + radius, xyz.max(0)[:2] - radius
    ranges[~((xyz[:, :2] > lower) & (xyz[:, :2] < upper)).all(1)] += 1.0  # at the rim half the ground is unseen
    level = np.flatnonzero(ranges < 0.01)
    return xyz[level[np.argmax(xyz[level, 2])]] if len(level) else xyz[np.argmin(ranges)]
