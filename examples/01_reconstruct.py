"""Frames to a MuJoCo scene, and a ball dropped on the goal platform.

realsim synth --terrain mixed --frames 20 --width 320 --out synthetic     (or frames of your own)
python examples/01_reconstruct.py synthetic/capture
"""

import sys
from pathlib import Path
from tempfile import mkdtemp

import mujoco

import realsim as rs

scene = rs.reconstruct(sys.argv[1], Path(mkdtemp()) / "scene")
print(f"{scene.verdict}: scale {scene.scale}, files in {scene.folder}")

x, y, z = scene.goal.center
spec = scene.spec()
ball = spec.worldbody.add_body(pos=[x, y, z + 0.3])
ball.add_freejoint()
ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0])
model = spec.compile()
data = mujoco.MjData(model)
for _ in range(1000):
    mujoco.mj_step(model, data)
print(f"the ball rests {1000 * (data.qpos[2] - z - 0.05):+.1f} mm from where the platform was seen")
