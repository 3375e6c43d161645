"""Is the scene on disk what it says? Compile it, step it, and drop things on its platforms."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import ExportError
from realsim.core.types import Platform, platform_names

SETTLE, REST = 1.0, 0.2  # seconds of falling and coming to rest, and of being at rest
KINDS = ("sphere", "box")
RADIUS = 0.04  # of the sphere, and half the box's side
DROP = 0.02  # metres above the platform


def check_scene(scene_xml: Path, platforms: Sequence[Platform], robot: str | None) -> dict[str, Any]:
    """Compile the scene from its file, step it, and drop a sphere and a box on every platform.

    Args:
        robot: name of the root body that has to be standing after the steps, or None.

    Returns:
        JSON-able: `steps`, `seconds`, and `drops`, one {platform, object, error_m} each, where the error is the
        resting height of the object's lowest point, had it landed level, above the platform's centroid; the worst
        of the time in which it should be at rest.

    Raises:
        ExportError: it does not compile, diverges, or the robot falls.
    """
    import mujoco

    try:
        model = mujoco.MjModel.from_xml_path(str(scene_xml))
    except ValueError as error:
        raise ExportError("the scene does not compile", file=scene_xml, found=str(error)) from error
    result = _step(model, scene_xml, robot)
    return result | {"drops": _drop(scene_xml, platforms, robot)}


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
    _converged(data, scene_xml)
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


def _converged(data: Any, scene_xml: Path) -> None:
    if not np.isfinite(data.qpos).all() or any(w.number for w in data.warning):
        raise ExportError("the scene does not step", file=scene_xml, found="the simulation diverged")


def _drop(scene_xml: Path, platforms: Sequence[Platform], robot: str | None) -> list[dict[str, Any]]:
    """All objects at once; they touch the terrain and not each other, and the robot is away."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(scene_xml))
    if robot:
        for key in list(spec.keys):
            spec.delete(key)
        spec.delete(spec.body(robot))
    dropped = [(name, kind, p) for name, p in zip(platform_names(platforms), platforms, strict=True) for kind in KINDS]
    for name, kind, platform in dropped:
        _add_object(spec, f"{kind} on {name}", kind, platform)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(SETTLE / model.opt.timestep))
    bodies = [model.body(f"{kind} on {name}").id for name, kind, _ in dropped]
    level = np.array([RADIUS + p.centroid[2] for _, _, p in dropped])
    errors = []
    for _ in range(round(REST / model.opt.timestep)):
        mujoco.mj_step(model, data)
        errors.append(data.xpos[bodies, 2] - level)
    _converged(data, scene_xml)
    worst = np.abs(errors).argmax(0)
    return [
        {"platform": name, "object": kind, "error_m": float(errors[worst[i]][i])}
        for i, (name, kind, _) in enumerate(dropped)
    ]


def _add_object(spec: Any, name: str, kind: str, platform: Platform) -> None:
    """Free to fall and to lie down, and not to travel: on a tilted top a sphere rolls and says nothing of the height
    at the place where it was dropped."""
    import mujoco

    x, y, z = platform.centroid
    body = spec.worldbody.add_body(name=name, pos=[x, y, z + RADIUS + DROP])
    body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
    body.add_joint(type=mujoco.mjtJoint.mjJNT_BALL)
    # Their contype is 0: they are touched by the terrain (contype 1, against their conaffinity 1) and not by each
    # other. Without friction (condim 1, and theirs counts) the box turns until it lies flat.
    shape = mujoco.mjtGeom.mjGEOM_SPHERE if kind == "sphere" else mujoco.mjtGeom.mjGEOM_BOX
    body.add_geom(type=shape, size=[RADIUS] * 3, mass=0.5, contype=0, conaffinity=1, condim=1, priority=1)
