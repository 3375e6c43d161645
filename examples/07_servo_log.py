"""Logs of a hobby servo that swings a lever, as CSV files, and the model that is believed in.

    python examples/07_servo_log.py servo

The "servo" is simulated. Its gears have 0.1 N m more dry friction than servo.xml says.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

MODEL = """
<mujoco model="servo">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="lever"><joint name="swing" axis="0 1 0" damping="0.02" armature="0.004" frictionloss="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".012" mass="0.15"/>
      <geom type="sphere" pos="0 0 -.2" size=".03" mass="0.35"/></body>
  </worldbody>
  <actuator><position name="servo" joint="swing" kp="12" kv="0.4" forcerange="-3 3"/></actuator>
</mujoco>"""

out = Path(sys.argv[1])
(out / "runs").mkdir(parents=True)
(out / "servo.xml").write_text(MODEL)
servo = mujoco.MjModel.from_xml_string(MODEL)
servo.dof_frictionloss[0] += 0.1
for run in range(6):
    rng, data = np.random.default_rng(run), mujoco.MjData(servo)
    rate, size, phase = rng.uniform(0.3, 1.6), rng.uniform(0.3, 0.9), rng.uniform(0, 6)
    rows = []
    for k in range(7000):
        t = k * 0.001
        if k % 8 == 0:
            data.ctrl[0] = size * np.sin(2 * np.pi * rate * t + phase) * np.clip((t - 0.5) / 0.3, 0, 1)
            rows.append([t, data.ctrl[0], data.qpos[0] + rng.normal(0, 3e-4)])
        mujoco.mj_step(servo, data)
    np.savetxt(out / "runs" / f"run_{run}.csv", rows, "%.6f", ",", header="stamp,target,angle", comments="")
(out / "columns.json").write_text('{"time": "stamp", "command": ["target"], "joint_pos": ["angle"]}\n')
print(f"6 runs and servo.xml in {out}")
