"""A picture of a scene as MuJoCo draws it, the robot at its first keyframe.

Drawing runs in a process of its own: MuJoCo chooses its OpenGL library when it is imported, and a broken driver may end
the process. As a script: `python -m realsim.report.picture SCENE.xml OUT.png WIDTH HEIGHT`.
"""

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from realsim.core.errors import RealsimError
from realsim.core.types import F64, U8

BACKENDS = ("egl", "osmesa", "glfw")
"""OpenGL libraries in the order in which they are tried where MUJOCO_GL does not name one."""
_SECONDS = 120


def draw(scene_xml: Path, width: int = 960, height: int = 720) -> U8:
    """(height, width, 3) RGB of a scene.

    Raises:
        RealsimError: no OpenGL library of this machine could draw it.
    """
    import cv2

    given = os.environ.get("MUJOCO_GL")
    failures = []
    with TemporaryDirectory() as folder:
        out = Path(folder) / "picture.png"
        for backend in (given,) if given else BACKENDS:
            command = [
                sys.executable,
                "-m",
                "realsim.report.picture",
                str(scene_xml),
                str(out),
                str(width),
                str(height),
            ]
            try:
                done = subprocess.run(
                    command, env=os.environ | {"MUJOCO_GL": backend}, capture_output=True, timeout=_SECONDS, check=False
                )
            except subprocess.TimeoutExpired:
                failures.append(f"{backend}: no picture after {_SECONDS} s")
                continue
            image = cv2.imread(str(out)) if out.is_file() else None
            if done.returncode == 0 and image is not None:
                return np.ascontiguousarray(image[..., ::-1])
            words = done.stderr.decode(errors="replace").strip().splitlines()
            failures.append(f"{backend}: {words[-1][:200] if words else f'exit code {done.returncode}'}")
    raise RealsimError(
        "MuJoCo cannot draw on this machine",
        found="; ".join(failures),
        hint="set MUJOCO_GL=egl (GPU) or MUJOCO_GL=osmesa (CPU, Debian package libosmesa6)",
    )


def _render(scene_xml: Path, width: int, height: int) -> U8:
    """Draw in this process."""
    import mujoco

    from realsim.report.collision import load

    model, data = load(scene_xml)
    # The renderer refuses a picture that is larger than the buffer that the model asks for.
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = standpoint(
        model, data, float(model.vis.global_.fovy), width / height
    )
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera)
        return np.asarray(renderer.render(), np.uint8)


def standpoint(model: Any, data: Any, fovy: float, aspect: float) -> tuple[F64, float, float, float]:
    """Look-at point (3,), distance, azimuth and elevation (degrees, as MuJoCo's) that show a whole scene.

    Args:
        fovy: vertical field of view, degrees; aspect: width over height of the picture.
    """
    view = model.vis.global_
    azimuth, elevation = float(view.azimuth), float(view.elevation)
    # (8 N, 3) corners of the boxes around all geoms but endless planes, in the world.
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    corners = [
        (model.geom_aabb[g, :3] + signs * model.geom_aabb[g, 3:]) @ data.geom_xmat[g].reshape(3, 3).T
        + data.geom_xpos[g]
        for g in range(model.ngeom)
        if model.geom_type[g] != 0
    ]
    return *_fitted(np.vstack(corners) if corners else signs, azimuth, elevation, fovy, aspect), azimuth, elevation


def _fitted(points: Any, azimuth: float, elevation: float, fovy: float, aspect: float) -> tuple[Any, float]:
    """(look-at point, distance) of the nearest camera in this direction that sees all points (N, 3)."""
    a, e = np.radians([azimuth, elevation])
    ahead = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    axes = np.stack([right, np.cross(right, ahead), ahead])
    seen = points @ axes.T
    target = (seen.min(0) + seen.max(0)) / 2
    half = np.tan(np.radians(fovy) / 2)
    away = np.abs(seen - target)
    needed = np.maximum(away[:, 0] / (half * aspect), away[:, 1] / half) - (seen - target)[:, 2]
    return target @ axes, 1.04 * float(needed.max())


if __name__ == "__main__":
    import cv2

    picture = _render(Path(sys.argv[1]), int(sys.argv[3]), int(sys.argv[4]))
    cv2.imwrite(sys.argv[2], picture[..., ::-1])
