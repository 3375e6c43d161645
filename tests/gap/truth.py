"""Small made-up robots whose gap is known: a servo loop of its own, a finer time step (1 ms), nuisances always on."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from tests.truths.written import write_case

PENDULUM = """
<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <body name="arm" pos="0 0 1">
      <joint name="swing" axis="0 1 0" frictionloss="0.15" damping="0.05" armature="0.02"/>
      <inertial pos="0 0 -0.25" mass="1.2" diaginertia="0.02 0.02 0.0005"/>
    </body>
  </worldbody>
  <actuator><position name="swing_servo" joint="swing" kp="30" kv="1" forcerange="-18 18"/></actuator>
</mujoco>"""

ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" frictionloss="0.5" damping="0.3" armature="0.08"/>
      <inertial pos="0 0 -0.2" mass="2.5" diaginertia="0.035 0.035 0.001"/>
      <body name="fore" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" frictionloss="0.25" damping="0.12" armature="0.03"/>
        <inertial pos="0 0 -0.17" mass="1.6" diaginertia="0.018 0.018 0.0005"/>
        <geom type="sphere" size="0.02" pos="0 0 -0.36" contype="0" conaffinity="0" mass="0"/>
        <site name="wrist" pos="0 0 -0.36"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder_servo" joint="shoulder" kp="150" kv="8" forcerange="-45 45"/>
    <position name="elbow_servo" joint="elbow" kp="60" kv="2.6" forcerange="-24 24"/>
  </actuator>
</mujoco>"""

FINE = ARM.replace('timestep="0.004"', 'timestep="0.002"')
"""Where what the step itself does would be seen."""


@dataclass
class Truth:
    """How the robot differs. Everything by joint is an array over joints."""

    delay: float = 0.0
    observation_delay: float = 0.0
    motor_gain: dict[str, float] = field(default_factory=dict)
    kp: dict[str, float] = field(default_factory=dict)
    kd: dict[str, float] = field(default_factory=dict)
    coulomb: dict[str, float] = field(default_factory=dict)
    viscous: dict[str, float] = field(default_factory=dict)
    stribeck: dict[str, float] = field(default_factory=dict)
    load: dict[str, float] = field(default_factory=dict)
    armature: dict[str, float] = field(default_factory=dict)
    limit: dict[str, float] = field(default_factory=dict)
    no_load_speed: dict[str, float] = field(default_factory=dict)
    offset: dict[str, float] = field(default_factory=dict)
    backlash: dict[str, float] = field(default_factory=dict)
    compliance: dict[str, float] = field(default_factory=dict)
    mass: dict[str, tuple[float, tuple[float, float, float]]] = field(default_factory=dict)
    com: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    inertia: dict[str, float] = field(default_factory=dict)
    force: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    force_window: tuple[float, float] = (-10.0, 100.0)
    """s of each run in which the force acts."""
    force_windows: tuple[tuple[float, float] | None, ...] = ()
    """The same run by run, where it comes at another time in each; None: not at all."""
    tilt: float = 0.0
    ripple: dict[str, float] = field(default_factory=dict)
    """Outside the library: torque that varies with the angle, N m."""
    fading: dict[str, float] = field(default_factory=dict)
    """Outside the library: the force of the motor falls during a run, to this ratio at its end."""


def commands(
    rng: np.random.Generator, kind: str, seconds: float, joints: int, rate: float, amplitude: float
) -> np.ndarray:
    """(T, J): rest for half a second, then a sine sum, steps, a slow triangle or a chirp."""
    t = np.arange(int(seconds / 0.001)) * 0.001
    ramp = np.clip((t - 0.5) / 0.3, 0, 1)
    out = []
    for _ in range(joints):
        centre = rng.uniform(-0.4, 0.4)
        if kind == "sines":
            f = rng.uniform(0.2, 1.4, 3)
            y = sum(np.sin(2 * np.pi * k * t + p) for k, p in zip(f, rng.uniform(0, 6, 3), strict=True)) / 2
        elif kind == "steps":
            y = rng.uniform(-1, 1, 20)[np.minimum((t / 0.7).astype(int), 19)]
        elif kind == "slow":
            y = 2 * np.abs(((t / 3.5 + rng.uniform(0, 1)) % 1) * 2 - 1) - 1
        else:
            y = np.sin(2 * np.pi * (0.2 * t + 0.5 * (rng.uniform(1.5, 2.2) / seconds) * t**2))
        out.append(centre + amplitude * ramp * y)
    return np.stack(out, axis=1)


def make_case(
    folder: Path,
    xml: str,
    truth: Truth,
    *,
    seed: int = 0,
    runs: int = 5,
    rate: float = 125.0,
    torque: str = "none",
    velocity: bool = True,
    nuisance: float = 1.0,
    imu: str | None = None,
    span: tuple[float, float] = (5.0, 6.5),
) -> Path:
    """Write a case of the contract whose robot differs from `xml` by `truth` and by small nuisances."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec.from_string(xml)
    nominal = spec.copy().compile()
    joints = [nominal.joint(i).name for i in range(nominal.njnt)]
    real = _robot(spec, truth, rng, nuisance)
    kinds = ["sines", "slow", "steps", "chirp", "sines", "slow", "chirp", "steps"]
    written: dict[str, dict[str, np.ndarray]] = {}
    drift = {j: nuisance * rng.normal(0, 0.02, 3) for j in joints}
    for i in range(runs):
        seconds = rng.uniform(*span)
        fine = commands(rng, kinds[i % len(kinds)], seconds, len(joints), rate, 0.6)
        window = (truth.force_windows[i] or (0.0, 0.0)) if truth.force_windows else truth.force_window
        now = replace(truth, force_window=window)
        data = replay(real, nominal, joints, fine, now, rng, rate, drift, nuisance)
        if torque == "none":
            data.pop("joint_torque")
        if not velocity:
            data.pop("joint_vel")
        written[f"run_{i + 1:02d}"] = {k: v.astype(np.float32) if k != "time" else v for k, v in data.items()}
    return write_case(folder, xml, written, command_hold="zoh", torque_kind=torque, imu_site=imu)


def _robot(spec, truth: Truth, rng: np.random.Generator, nuisance: float):
    spec = spec.copy()
    spec.option.timestep = 0.001
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    g = 9.81
    spec.option.gravity = [g * np.sin(truth.tilt), 0, -g * np.cos(truth.tilt)]
    for joint in list(spec.joints):
        n = joint.name
        joint.frictionloss = max(
            joint.frictionloss * (1 + nuisance * 0.03 * rng.normal()) + truth.coulomb.get(n, 0.0), 0
        )
        d = joint.damping
        d[0] = d[0] * (1 + nuisance * 0.03 * rng.normal()) + truth.viscous.get(n, 0.0)
        joint.damping = d
        joint.armature = joint.armature * (1 + nuisance * 0.02 * rng.normal()) + truth.armature.get(n, 0.0)
    for body in spec.bodies:
        if body.name == "world":
            continue
        scale = 1 + nuisance * 0.01 * rng.normal()
        body.mass, body.inertia = body.mass * scale, body.inertia * scale * truth.inertia.get(body.name, 1.0)
        body.ipos = body.ipos + np.array(truth.com.get(body.name, (0, 0, 0))) + nuisance * 0.001 * rng.normal(size=3)
        if body.name in truth.mass:
            mass, where = truth.mass[body.name]
            load = body.add_body(name="load", pos=where, mass=mass, inertia=np.full(3, 1e-6), explicitinertial=1)
            load.ipos, load.iquat = np.zeros(3), np.array([1.0, 0, 0, 0])
    for n in {*truth.backlash, *truth.compliance}:
        joint = spec.joint(n)
        rotor = spec.worldbody.add_body(name=f"rotor_{n}", mass=1e-4, inertia=np.full(3, 1e-8), explicitinertial=1)
        rotor.ipos, rotor.iquat = np.zeros(3), np.array([1.0, 0, 0, 0])
        motor = rotor.add_joint(name=f"rotor_{n}", axis=[0, 0, 1], armature=joint.armature)
        motor.frictionloss, motor.damping = joint.frictionloss, joint.damping
        joint.frictionloss, joint.armature, joint.damping = 0.0, 1e-4, [0.0, 0, 0]
        tendon = spec.add_tendon(name=f"gear_{n}")
        tendon.wrap_joint(f"rotor_{n}", 1.0)
        tendon.wrap_joint(n, -1.0)
        if n in truth.compliance:
            k = truth.compliance[n]
            tendon.stiffness, tendon.springlength, tendon.damping = [k, 0, 0], [0, 0], [0.002 * k, 0, 0]
        else:
            half = truth.backlash[n] / 2
            tendon.limited, tendon.range, tendon.solref_limit = 1, [-half, half], [0.002, 1]
    return spec.compile()


def replay(
    real, nominal, joints, fine, truth: Truth, rng, rate: float, drift, nuisance: float
) -> dict[str, np.ndarray]:
    """One run: the commands at the log's rate, held; the servo reads the motor side; the log the output side."""
    count = int(len(fine) * 0.001 * rate)
    true_time = np.arange(count) / rate
    command = fine[np.minimum((true_time * 1000).astype(int), len(fine) - 1)]
    data = mujoco.MjData(real)
    out = [real.joint(j).qposadr[0] for j in joints]
    motor = [real.joint(f"rotor_{j}" if j in {*truth.backlash, *truth.compliance} else j).qposadr[0] for j in joints]
    dof = [real.joint(f"rotor_{j}" if j in {*truth.backlash, *truth.compliance} else j).dofadr[0] for j in joints]
    link = [real.joint(j).dofadr[0] for j in joints]
    get = lambda d, default: np.array([d.get(j, default) for j in joints])  # noqa: E731
    gain, kp, kd = get(truth.motor_gain, 1.0), get(truth.kp, 1.0), get(truth.kd, 1.0)
    kp = kp * nominal.actuator_gainprm[:, 0] * (1 + np.array([drift[j][0] * 0.5 for j in joints]))
    kd = kd * -nominal.actuator_biasprm[:, 2] * (1 + np.array([drift[j][1] for j in joints]))
    limit = np.minimum(nominal.actuator_forcerange[:, 1], get(truth.limit, np.inf))
    v0, offset = get(truth.no_load_speed, np.inf), get(truth.offset, 0.0)
    stribeck, load, ripple = get(truth.stribeck, 0.0), get(truth.load, 0.0), get(truth.ripple, 0.0)
    fading = get(truth.fading, 1.0)
    data.qpos[out] = data.qpos[motor] = command[0] - offset
    end = true_time[-1]
    steps = int((end + 1.0) / 0.001)
    tau = np.zeros((steps, len(joints)))
    all_pos, all_vel = np.zeros((steps, real.nq)), np.zeros((steps, real.nv))
    qpos, qvel, applied = data.qpos, data.qvel, data.qfrc_applied
    delay = truth.delay + nuisance * 0.0005
    pushed = [(data.xfrc_applied[real.body(n).id], np.array([*f, 0, 0, 0])) for n, f in truth.force.items()]
    # Most robots have few of these: what is absent is not computed 1,000 times a second.
    slowing, rubbing = bool(truth.no_load_speed), bool(truth.stribeck or truth.load or truth.ripple)
    for k in range(steps):
        now = k * 0.001 - 1.0
        i = min(max(math.floor((now - delay) * rate), 0), count - 1)
        v = qvel[dof]
        torque = gain * (kp * (command[i] - qpos[motor] - offset) - kd * v)
        if truth.fading:
            torque = torque * (1 - (1 - fading) * max(now, 0) / end)
        top = np.maximum(np.minimum(limit, limit * (1 - np.sign(torque) * v / v0)), 0) if slowing else limit
        torque = np.minimum(np.maximum(torque, -top), top)
        if not rubbing:
            applied[dof] = torque
        else:
            extra = stribeck * np.exp(-((v / 0.15) ** 2)) * np.tanh(v / 0.002)
            extra += load * np.abs(torque) * np.tanh(v / 0.005)
            applied[dof] = torque - extra + ripple * np.sin(9 * qpos[motor])
        for wrench, f in pushed:
            wrench[:] = f * (truth.force_window[0] <= now < truth.force_window[1])
        all_pos[k], all_vel[k], tau[k] = qpos, qvel, torque
        mujoco.mj_step(real, data)
    pos, vel = all_pos[:, out], all_vel[:, link]
    jitter = nuisance * 2e-4
    time = true_time + rng.normal(0, jitter, count) if nuisance else true_time
    at = np.clip(((true_time + 1.0 - truth.observation_delay) / 0.001).astype(int), 0, steps - 1)
    quantum = 2 * np.pi / 16384
    reading = pos[at] + offset + nuisance * (rng.normal(0, 3e-4, (count, len(joints))) + 4e-4 * np.sin(pos[at]))
    if nuisance:
        reading = np.round(reading / quantum) * quantum
    reading[rng.random(count) < 0.003] = np.nan
    time = np.maximum.accumulate(time - time[0]) + np.arange(count) * 1e-9
    return {
        "time": time,
        "command": command,
        "joint_pos": reading,
        "joint_vel": vel[at] + nuisance * rng.normal(0, 0.02, (count, len(joints))),
        "joint_torque": tau[at] + nuisance * rng.normal(0, 0.05, (count, len(joints))),
    }
