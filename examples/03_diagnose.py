"""A robot that behaves differently from its simulator: write its log, find the cause, mend the simulator.

    python examples/03_diagnose.py

The "robot" is a simulated arm with 0.25 N m of dry friction that its model does not know of.
"""

import json
from pathlib import Path
from tempfile import mkdtemp

import mujoco
import numpy as np

import realsim as rs

ARM = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body><joint name="shoulder" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/>
      <body pos=".3 0 0"><joint name="elbow" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 .25 0 0" size=".025" mass="0.6"/></body></body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="40" kv="2"/><position name="elbow" joint="elbow" kp="20" kv="1"/>
  </actuator>
</mujoco>"""

case = Path(mkdtemp()) / "case"
(case / "runs").mkdir(parents=True)
(case / "model.xml").write_text(ARM)
joints = ["shoulder", "elbow"]
log = {"joint_names": joints, "actuator_names": joints, "command_kind": "position", "command_hold": "zoh"}
log |= {"base": "fixed", "torque_kind": "none", "imu_site": None, "contact_bodies": [], "notes": ""}
(case / "log.json").write_text(json.dumps(log))

robot = mujoco.MjModel.from_xml_string(ARM)
robot.dof_frictionloss[robot.joint("elbow").dofadr] = 0.25
for seed in range(4):
    rng, data = np.random.default_rng(seed), mujoco.MjData(robot)
    rate, size = rng.uniform(0.2, 1.2, 2), rng.uniform(0.2, 0.7, 2)
    mujoco.mj_step(robot, data, 2000)  # a run begins at rest: the arm has sagged into its servos
    data.time, rows = 0.0, []
    for k in range(2000):
        if k % 4 == 0:
            data.ctrl = size * np.sin(2 * np.pi * rate * data.time)
            noise = rng.normal(0, [2e-4, 2e-4, 5e-3, 5e-3])
            rows.append([data.time, *data.ctrl, *(np.append(data.qpos, data.qvel) + noise)])
        mujoco.mj_step(robot, data)
    log = np.array(rows)
    signals = {"time": log[:, 0], "command": log[:, 1:3], "joint_pos": log[:, 3:5], "joint_vel": log[:, 5:]}
    np.savez(case / "runs" / f"run_{seed}.npz", **signals)

found = rs.diagnose(case, case.parent / "diagnosis")
print(found.sentence)

mended = mujoco.MjSpec.from_file(str(case / "model.xml"))
rs.apply_patch(mended, found)
print("friction of the elbow in the mended model:", mended.compile().joint("elbow").frictionloss, "N m")
