"""Is the scene on disk what it says? Compile it, step it, and drop things on its platforms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.errors import ExportError
from realsim.exports.mjcf import platform_names
from realsim.types import Platform

SETTLE = 1.0  # seconds
RADIUS = 0.04  # of the sphere, and half the box's side
DROP = 0.02  # metres above the platform


def check_scene(scene_xml: Path, platforms: Sequence[Platform], tolerance: float, robot: str | None) -> dict[str, Any]:
    """Compile the scene from its file, step it, and drop a sphere and a box on every platform.

    Args:
        tolerance: metres by which a dropped object may come to rest above or below the platform's height.
        robot: name of the root body that has to be standing after the steps, or None.

    Returns:
        JSON-able: `steps`, `seconds`, and `drops`, one {platform, object, error_m} each, where the error is the
        resting height of the object's lowest point above the platform's centroid.

    Raises:
        ExportError: it does not compile, diverges, the robot falls, or an object does not rest on its platform.
    """
    model = _compile(scene_xml)
    result = _step(model, scene_xml, robot)
    return result | {"drops": _drop(scene_xml, platforms, tolerance, robot)}


def _compile(scene_xml: Path) -> Any:
    import mujoco

    try:
        return mujoco.MjModel.from_xml_path(str(scene_xml))
    except ValueError as error:
        raise ExportError("the scene does not compile", file=scene_xml, found=str(error)) from error


def _step(model: Any, scene_xml: Path, robot: str | None) -> dict[str, Any]:
    """One second from the key frame `home`, if there is one: a robot in it has to be standing at the end."""
    import mujoco

    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    before = data.body(robot).xpos.copy() if robot else np.zeros(3)
    steps = round(SETTLE / model.opt.timestep)
    mujoco.mj_step(model, data, nstep=steps)
    if not np.isfinite(data.qpos).all() or any(w.number for w in data.warning):
        raise ExportError("the scene does not step", file=scene_xml, found="the simulation diverged")
    result: dict[str, Any] = {"steps": steps, "seconds": SETTLE}
    if robot:
        moved = float(np.abs(data.body(robot).xpos - before).max())
        if moved > 0.1:
            raise ExportError(
                "the robot does not stand on the start platform",
                file=scene_xml,
                expected=f"{robot} within 0.1 m of its place after {SETTLE:g} s",
                found=f"{moved:.3f} m away",
                hint="look at the start platform in the viewer; another one can be chosen with --start X Y",
            )
        result["robot_moved_m"] = moved
    return result


def _drop(scene_xml: Path, platforms: Sequence[Platform], tolerance: float, robot: str | None) -> list[dict[str, Any]]:
    """All objects at once; they touch the terrain and not each other, and the robot is away."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(scene_xml))
    if robot:
        _remove_robot(spec, robot)
    names = platform_names(platforms)
    for name, platform in zip(names, platforms, strict=True):
        _add_object(spec, f"sphere on {name}", mujoco.mjtGeom.mjGEOM_SPHERE, platform)
        _add_object(spec, f"box on {name}", mujoco.mjtGeom.mjGEOM_BOX, platform)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(SETTLE / model.opt.timestep))
    drops = []
    for name, platform in zip(names, platforms, strict=True):
        for kind in ("sphere", "box"):
            body = data.body(f"{kind} on {name}")
            error = float(body.xpos[2]) - RADIUS - float(platform.centroid[2])
            speed = float(np.linalg.norm(body.cvel[3:]))
            if not abs(error) <= tolerance or not speed < 0.05:
                raise ExportError(
                    f"the {kind} dropped on {name} does not rest on it",
                    file=scene_xml,
                    expected=f"{float(platform.centroid[2]):.3f} m within {tolerance * 1000:.0f} mm, at rest",
                    found=f"{error * 1000:+.1f} mm beside it, {speed:.2f} m/s after {SETTLE:g} s",
                    hint="look at collision geometry (group 3) and platform sites (group 4) in the viewer",
                )
            drops.append({"platform": name, "object": kind, "error_m": error})
    return drops


def _add_object(spec: Any, name: str, kind: Any, platform: Platform) -> None:
    x, y, z = platform.centroid
    body = spec.worldbody.add_body(name=name, pos=[x, y, z + RADIUS + DROP])
    body.add_freejoint()
    # Their contype is 0: they are touched by the terrain (contype 1, against their conaffinity 1) and not by each
    # other. Rolling friction keeps the sphere where it is on a top that is a fraction of a degree off level.
    body.add_geom(
        type=kind, size=[RADIUS] * 3, mass=0.5, contype=0, conaffinity=1, condim=6, friction=[1.0, 0.02, 0.02]
    )


def _remove_robot(spec: Any, root: str) -> None:
    for key in list(spec.keys):
        spec.delete(key)
    spec.delete(spec.body(root))
