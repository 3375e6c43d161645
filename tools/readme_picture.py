"""Makes the picture of the README from a demo: a camera frame, and the scene with the robot.

python tools/readme_picture.py demo_out docs/images/demo.jpg
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import mujoco
import numpy as np

HEIGHT = 480


def main(demo: Path, out: Path) -> None:
    frames = sorted((demo / "frames" / "capture" / "color").glob("*.jpg"))
    frame = cv2.imread(str(frames[len(frames) // 4]))
    picture = np.hstack([fit(frame), np.full((HEIGHT, 8, 3), 255, np.uint8), fit(render(demo / "scene" / "scene.xml"))])
    out.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(out), picture, [cv2.IMWRITE_JPEG_QUALITY, 85])


def fit(image: np.ndarray) -> np.ndarray:
    """The image at the common height."""
    width = round(image.shape[1] * HEIGHT / image.shape[0])
    return cv2.resize(image, (width, HEIGHT), interpolation=cv2.INTER_AREA)


def render(scene: Path) -> np.ndarray:
    """The scene as MuJoCo draws it, the robot on the start platform."""
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = [1.5, 0.0, 0.1]
    camera.distance, camera.azimuth, camera.elevation = 4.0, 125, -25
    with mujoco.Renderer(model, 960, 1280) as renderer:
        renderer.update_scene(data, camera)
        return renderer.render()[..., ::-1]


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
