"""Robots of MuJoCo Menagerie, through the package robot_descriptions (extra `menagerie`)."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import ExportError, MissingExtraError, UnknownNameError
from realsim.robots.base import Robot


def menagerie(name: str) -> Robot:
    """The robot that Menagerie calls `name` (`unitree_go2`, or robot_descriptions' shorter `go2`), in its own pose
    `home` where it has one. Needs the network the first time; robot_descriptions keeps a copy.

    Raises:
        MissingExtraError: robot_descriptions is not installed.
        UnknownNameError: no MJCF description of that name.
        ExportError: the description cannot be fetched, or its root body is not a floating base.
    """
    try:
        from robot_descriptions import DESCRIPTIONS
    except ImportError as error:
        raise MissingExtraError("robot_descriptions", "menagerie", f"menagerie:{name}") from error
    known = [d.removesuffix("_mj_description") for d in DESCRIPTIONS if d.endswith("_mj_description")]
    short = next((k for k in (name, name.partition("_")[2]) if k in known), None)
    if short is None:
        raise UnknownNameError("Menagerie robot", name, known)
    try:
        path = Path(import_module(f"robot_descriptions.{short}_mj_description").MJCF_PATH)
    except Exception as error:  # git, network and file system errors of the fetching package, whatever their type
        raise ExportError(
            f"menagerie:{name} cannot be fetched", found=str(error), hint="connect to the network once, or use g1"
        ) from error
    return from_mjcf(name, path)


def from_mjcf(name: str, path: Path) -> Robot:
    """A robot of any MJCF file with one floating base; meshes and textures come along.

    The feet are taken to be the lowest collision geoms of the pose `home` (the first key frame, else the zero pose).
    """
    import mujoco

    spec = mujoco.MjSpec.from_file(str(path))
    model = spec.compile()
    if not model.njnt or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        raise ExportError("the robot has no floating base", file=path, expected="a free joint on its first body")
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_forward(model, data)
    root = model.body(model.jnt_bodyid[0]).name
    joints = [j for j in range(1, model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]
    home = {model.joint(j).name: float(data.qpos[model.jnt_qposadr[j]]) for j in joints}
    height = -_lowest(model, data)
    qpos, ctrl = data.qpos.copy(), data.ctrl.copy() if not model.nkey else model.key_ctrl[0].copy()
    qpos[2] = height
    for key in list(spec.keys):
        spec.delete(key)
    spec.body(root).pos = [0, 0, height]
    spec.add_key(name="home", qpos=qpos, ctrl=ctrl)
    return Robot(name, spec, root, height, home, _bundle(spec, path))


def _lowest(model: Any, data: Any) -> float:
    """z of the lowest point of the axis-aligned boxes of the colliding geoms."""
    lowest = np.inf
    for g in range(model.ngeom):
        if model.geom_bodyid[g] and (model.geom_contype[g] or model.geom_conaffinity[g]):
            centre, half = model.geom_aabb[g, :3], model.geom_aabb[g, 3:]
            R = data.geom_xmat[g].reshape(3, 3)
            lowest = min(lowest, float((data.geom_xpos[g] + R @ centre)[2] - np.abs(R[2]) @ half))
    return lowest


def _bundle(spec: Any, path: Path) -> dict[str, bytes]:
    """Read every mesh and texture, and let the specification refer to it below `robot/`."""
    files: dict[str, bytes] = {}
    folders = {"meshes": spec.meshdir, "textures": spec.texturedir}
    for kind, folder in folders.items():
        for item in getattr(spec, kind):
            if item.file:
                relative = f"robot/{kind}/{Path(item.file).as_posix()}"
                files[relative] = (path.parent / folder / item.file).read_bytes()
                item.file = relative
    spec.meshdir = spec.texturedir = ""
    return files
