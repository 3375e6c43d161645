"""Frames to a MuJoCo scene, and a ball dropped on the goal platform.

    python examples/reconstruct.py [FRAMES]

Without a folder of frames it renders a small synthetic capture first.
"""

import sys
from pathlib import Path
from tempfile import mkdtemp

import mujoco

from realsim.pipeline import ReconstructConfig, reconstruct
from realsim.synth.capture import write_capture
from realsim.synth.config import SynthConfig

work = Path(mkdtemp())
if len(sys.argv) > 1:
    frames = Path(sys.argv[1])
else:
    frames = write_capture(work / "synthetic", SynthConfig(terrain="mixed", frames=20, width=320)).capture

found = reconstruct(frames, work / "scene", ReconstructConfig())
goal = found.aligned.platform("goal").centroid
print(f"scale {found.aligned.metric.scale.value:.4f}, goal {goal[0]:.2f} m ahead, files in {work / 'scene'}")

spec = mujoco.MjSpec.from_file(str(found.scene.scene_xml))
ball = spec.worldbody.add_body(pos=[goal[0], goal[1], goal[2] + 0.3])
ball.add_freejoint()
ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0])
model = spec.compile()
data = mujoco.MjData(model)
for _ in range(1000):
    mujoco.mj_step(model, data)
print(f"the ball rests {1000 * (data.qpos[2] - goal[2] - 0.05):+.1f} mm from where the platform was seen")
