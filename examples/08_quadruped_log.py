"""Logs of a quadruped that sways on the spot, and the model that is believed in.

    python examples/08_quadruped_log.py quadruped

The "robot" is simulated. It carries 1.5 kg at the back of its trunk, which quadruped.xml does not know of.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

from realsim import robots

out = Path(sys.argv[1])
(out / "runs").mkdir(parents=True)
spec = robots.load("quadruped").placed(np.zeros(3)).spec
spec.option.timestep = 0.002
spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
spec.compile()
(out / "quadruped.xml").write_text(spec.to_xml())
home = np.array(spec.keys[0].ctrl)
box = spec.body("trunk").add_body(name="payload", pos=[-0.12, 0, 0.08])
box.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.06, 0.06, 0.04], mass=1.5, contype=0, conaffinity=0)
robot = spec.compile()
legs = np.array([[x, y] for x in (1, -1) for y in (1, -1)])  # FL, FR, RL, RR
for run in range(5):
    rng, data = np.random.default_rng(run), mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, 0)
    data.ctrl[:] = home
    mujoco.mj_step(robot, data, 1500)  # it stands and has sagged into its servos
    data.time = 0.0
    rates, phases = rng.uniform(0.3, 1.0, 3), rng.uniform(0, 6, 3)
    log = {name: [] for name in ("time", "command", "joint_pos", "joint_vel", "base_pos", "base_quat")}
    start = data.qpos.copy()
    for k in range(2500):
        if k % 5 == 0:
            ramp = min(1.0, max(0.0, (data.time - 0.5) / 0.5))
            crouch, pitch, roll = ramp * np.array([0.15, 0.07, 0.05]) * np.sin(2 * np.pi * rates * data.time + phases)
            bend = crouch + pitch * legs[:, 0]
            data.ctrl[:] = home + np.stack([roll + 0 * bend, bend, -2 * bend], axis=1).ravel()
            sample = (data.time, data.ctrl, data.qpos[7:] + rng.normal(0, 3e-4, 12),
                      data.qvel[6:] + rng.normal(0, 0.01, 12), data.qpos[:3], data.qpos[3:7])  # fmt: skip
            for name, value in zip(log, sample, strict=True):
                log[name].append(np.array(value))
        mujoco.mj_step(robot, data)
    np.savez(out / "runs" / f"run_{run}.npz", init_qpos=start, **{k: np.array(v) for k, v in log.items()})
print(f"5 runs and quadruped.xml in {out}")
