"""Nominal robots: what the operator believes. Sizes and gains differ from case to case: nothing can be learnt by heart."""

from dataclasses import dataclass

import mujoco
import numpy as np

from tests.truths.diagnosis.mjspec import set_first

HEAD = """<mujoco model="{name}">
  <compiler angle="radian" autolimits="true" inertiafromgeom="false"/>
  <option timestep="0.002" integrator="implicitfast"{option}/>
  <default><geom contype="0" conaffinity="1" mass="0" friction="0.8 0.02 0.001"/></default>
  <worldbody>
"""


@dataclass(frozen=True)
class Robot:
    """A nominal model and how it may be driven."""

    name: str
    xml: str
    base: str
    joints: tuple[str, ...]
    home: np.ndarray
    """(J,) rad, the pose that motions start from and return to."""
    reach: np.ndarray
    """(J,) rad, the largest excursion from home."""
    imu_site: str | None = None
    contact_bodies: tuple[str, ...] = ()
    supports: tuple[str, ...] = ()
    """Bodies of the terrain that carry the feet."""

    @property
    def actuators(self) -> tuple[str, ...]:
        return tuple(f"{j}_servo" for j in self.joints)


def _vary(rng: np.random.Generator, value: float, by: float = 0.15) -> float:
    return round(float(value * rng.uniform(1 - by, 1 + by)), 6)


def _rod(mass: float, length: float, radius: float = 0.03) -> str:
    across = mass * (length**2 / 12 + radius**2 / 4)
    return f'mass="{mass:.6g}" diaginertia="{across:.6g} {across:.6g} {mass * radius**2 / 2:.6g}"'


def _joint(name: str, axis: str, low: float, high: float, friction: float, damping: float, armature: float) -> str:
    return (
        f'<joint name="{name}" type="hinge" axis="{axis}" range="{low} {high}" limited="true" '
        f'frictionloss="{friction:.6g}" damping="{damping:.6g}" armature="{armature:.6g}"/>'
    )


def _servo(name: str, kp: float, kv: float, force: float) -> str:
    return f'    <position name="{name}_servo" joint="{name}" kp="{kp:.6g}" kv="{kv:.6g}" forcerange="{-force:.6g} {force:.6g}"/>\n'


def pendulum(rng: np.random.Generator) -> Robot:
    """A heavy rod on one drive."""
    m, length = _vary(rng, 1.2), _vary(rng, 0.45)
    torque = 9.81 * m * length / 2
    arm = _vary(rng, 0.012)
    inertia = m * length**2 / 3 + arm
    kp = inertia * (2 * np.pi * rng.uniform(3.0, 4.5)) ** 2
    xml = HEAD.format(name="rod", option="") + (
        f'    <body name="mount" pos="0 0 1"><body name="rod">\n'
        f"      {_joint('axis', '0 1 0', -3, 3, 0.03 * torque + 0.05, 0.02, arm)}\n"
        f'      <inertial pos="0 0 {-length / 2:.6g}" {_rod(m, length)}/>\n'
        f'      <geom name="rod_geom" type="capsule" fromto="0 0 0 0 0 {-length:.6g}" size="0.02"/>\n'
        f"    </body></body>\n  </worldbody>\n  <actuator>\n"
        + _servo("axis", kp, 1.2 * np.sqrt(kp * inertia), 3.2 * torque)
        + "  </actuator>\n</mujoco>\n"
    )
    return Robot("pendulum", xml, "fixed", ("axis",), np.zeros(1), np.array([1.1]))


def arm2(rng: np.random.Generator) -> Robot:
    """Two links in a vertical plane."""
    m1, m2, l1, l2 = _vary(rng, 2.5), _vary(rng, 1.4), _vary(rng, 0.4), _vary(rng, 0.34)
    a1, a2 = _vary(rng, 0.08), _vary(rng, 0.03)
    i1 = a1 + m1 * l1**2 / 3 + m2 * (l1**2 + l2**2 / 3)
    i2 = a2 + m2 * l2**2 / 3
    g1, g2 = 9.81 * (m1 * l1 / 2 + m2 * (l1 + l2 / 2)), 9.81 * m2 * l2 / 2
    w = 2 * np.pi * rng.uniform(2.2, 3.2)
    xml = HEAD.format(name="vertical_arm", option="") + (
        f'    <body name="column" pos="0 0 1"><body name="upper">\n'
        f"      {_joint('shoulder', '0 1 0', -2.8, 2.8, _vary(rng, 0.5), _vary(rng, 0.25), a1)}\n"
        f'      <inertial pos="0 0 {-l1 / 2:.6g}" {_rod(m1, l1)}/>\n'
        f'      <geom name="upper_geom" type="capsule" fromto="0 0 0 0 0 {-l1:.6g}" size="0.03"/>\n'
        f'      <body name="fore" pos="0 0 {-l1:.6g}">\n'
        f"        {_joint('elbow', '0 1 0', -2.6, 2.6, _vary(rng, 0.28), _vary(rng, 0.1), a2)}\n"
        f'        <inertial pos="0 0 {-l2 / 2:.6g}" {_rod(m2, l2, 0.025)}/>\n'
        f'        <geom name="fore_geom" type="capsule" fromto="0 0 0 0 0 {-l2:.6g}" size="0.025"/>\n'
        f"      </body>\n    </body></body>\n  </worldbody>\n  <actuator>\n"
        + _servo("shoulder", i1 * w**2, 1.1 * i1 * w, 2.4 * g1)
        + _servo("elbow", i2 * w**2 * 1.5, 1.2 * i2 * w, 3.0 * g2)
        + "  </actuator>\n</mujoco>\n"
    )
    return Robot("arm2", xml, "fixed", ("shoulder", "elbow"), np.zeros(2), np.array([0.8, 0.9]))


def arm6(rng: np.random.Generator) -> Robot:
    """A six-joint arm on a bench, its flange with an IMU."""
    names = ("base_yaw", "shoulder", "elbow", "wrist_roll", "wrist_pitch", "flange")
    axes = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
    lengths = [_vary(rng, x) for x in (0.15, 0.35, 0.3, 0.12, 0.1, 0.06)]
    masses = [_vary(rng, x) for x in (3.0, 3.6, 2.2, 1.1, 0.8, 0.4)]
    armatures = [_vary(rng, x) for x in (0.35, 0.4, 0.25, 0.08, 0.06, 0.03)]
    kps = [_vary(rng, x) for x in (350, 500, 300, 80, 60, 25)]
    limits = [_vary(rng, x) for x in (60, 90, 50, 18, 14, 7)]
    text, close = HEAD.format(name="bench_arm", option=' impratio="5"'), ""
    offset = 0.0
    for i, name in enumerate(names):
        text += f'    <body name="link{i + 1}" pos="0 0 {offset:.6g}">\n      '
        text += _joint(name, axes[i], -2.9, 2.9, 0.02 * limits[i], 0.06 * np.sqrt(kps[i] * armatures[i]), armatures[i])
        text += f'\n      <inertial pos="0 0 {lengths[i] / 2:.6g}" {_rod(masses[i], lengths[i], 0.045)}/>\n'
        text += (
            f'      <geom name="link{i + 1}_geom" type="capsule" fromto="0 0 0 0 0 {lengths[i]:.6g}" size="0.04"/>\n'
        )
        if i == 5:
            text += f'      <site name="flange_imu" pos="0 0 {lengths[i]:.6g}"/>\n'
        offset, close = lengths[i], close + "</body>"
    text += f"    {close}\n  </worldbody>\n  <actuator>\n"
    for name, kp, arm, limit in zip(names, kps, armatures, limits, strict=True):
        text += _servo(name, kp, 1.6 * np.sqrt(kp * (arm + 0.1 * arm)), limit)
    home = np.array([0.0, 0.5, 1.0, 0.0, 0.6, 0.0])
    reach = np.array([0.7, 0.45, 0.5, 0.7, 0.6, 0.9])
    return Robot("arm6", text + "  </actuator>\n</mujoco>\n", "fixed", names, home, reach, "flange_imu")


def quadruped(rng: np.random.Generator) -> Robot:
    """A twelve-joint quadruped with a foot on a block each."""
    thigh, trunk = _vary(rng, 0.21, 0.08), _vary(rng, 7.5)
    x, y, out = 0.185, 0.05, 0.085
    bend = 0.8
    height = 2 * thigh * np.cos(bend) + 0.02
    tops = [_vary(rng, 0.03, 0.3) for _ in range(4)]
    lift = max(tops)
    corners = [("fl", 1, 1), ("fr", 1, -1), ("hl", -1, 1), ("hr", -1, -1)]
    text = HEAD.format(name="quadruped", option=' impratio="5" cone="elliptic"')
    surface = 'contype="1" conaffinity="0" priority="1" solref="0.01 1" friction="0.8 0.02 0.001"'
    text += f'    <geom name="floor" type="plane" size="5 5 0.1" {surface}/>\n'
    for k, ((_, sx, sy), top) in enumerate(zip(corners, tops, strict=True)):
        text += (
            f'    <body name="block_{k + 1}" pos="{sx * x:.6g} {sy * (y + out):.6g} {top:.6g}">'
            f'<inertial pos="0 0 0" mass="2" diaginertia="0.006 0.006 0.01"/>'
            f'<geom name="block_{k + 1}_geom" type="box" size="0.09 0.075 {top:.6g}" {surface}/></body>\n'
        )
    text += f'    <body name="trunk" pos="0 0 {height + 2 * lift:.6g}">\n      <freejoint name="root"/>\n'
    text += f'      <inertial pos="0.004 0 0.005" mass="{trunk:.6g}" diaginertia="{trunk * 0.0043:.6g} {trunk * 0.0157:.6g} {trunk * 0.018:.6g}"/>\n'
    text += '      <geom name="trunk_geom" type="box" size="0.2 0.09 0.05"/>\n      <site name="trunk_imu" pos="0.02 0 0.03"/>\n'
    joints: list[str] = []
    for leg, sx, sy in corners:
        joints += [f"{leg}_hip", f"{leg}_thigh", f"{leg}_calf"]
        text += (
            f'      <body name="{leg}_hip_link" pos="{sx * x:.6g} {sy * y:.6g} 0">{_joint(f"{leg}_hip", "1 0 0", -0.9, 0.9, 0.15, 0.09, 0.012)}\n'
            f'        <inertial pos="0 {sy * 0.03:.6g} 0" mass="0.6" diaginertia="0.0006 0.0008 0.0006"/>\n'
            f'        <body name="{leg}_thigh_link" pos="0 {sy * out:.6g} 0">{_joint(f"{leg}_thigh", "0 1 0", -1, 2.6, 0.15, 0.09, 0.012)}\n'
            f'          <inertial pos="0 0 {-0.17 * thigh:.6g}" mass="0.95" diaginertia="0.0034 0.0034 0.0004"/>\n'
            f'          <body name="{leg}_calf_link" pos="0 0 {-thigh:.6g}">{_joint(f"{leg}_calf", "0 1 0", -2.7, -0.4, 0.18, 0.11, 0.015)}\n'
            f'            <inertial pos="0 0 {-0.45 * thigh:.6g}" mass="0.22" diaginertia="0.0008 0.0008 0.00002"/>\n'
            f'            <geom name="{leg}_foot_geom" type="sphere" pos="0 0 {-thigh:.6g}" size="0.02"/>\n'
            f"          </body></body></body>\n"
        )
    text += "    </body>\n  </worldbody>\n  <actuator>\n"
    for joint in joints:
        text += _servo(joint, _vary(rng, 110, 0.1), _vary(rng, 2.6, 0.1), 24.0 if "calf" not in joint else 36.0)
    home = np.tile([0.0, bend, -2 * bend], 4)
    reach = np.tile([0.18, 0.3, 0.4], 4)
    feet = tuple(f"{leg}_calf_link" for leg, _, _ in corners)
    blocks = tuple(f"block_{k + 1}" for k in range(4))
    return Robot(
        "quadruped",
        text + "  </actuator>\n</mujoco>\n",
        "floating",
        tuple(joints),
        home,
        reach,
        "trunk_imu",
        feet,
        blocks,
    )


def g1(rng: np.random.Generator) -> Robot:
    """Unitree G1 hung by the pelvis: its drives and links without the ground."""
    from realsim.robots import ROBOTS

    spec = ROBOTS["g1"]().spec
    for body in spec.bodies:
        for joint in list(body.joints):
            if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                spec.delete(joint)
    for key in list(spec.keys):
        spec.delete(key)
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    joints = tuple(j.name for j in spec.joints)
    for actuator in list(spec.actuators):
        if actuator.target in joints:
            actuator.name = f"{actuator.target}_servo"
    for joint in spec.joints:
        joint.frictionloss = 0.15 + 0.01 * float(rng.random())
        set_first(joint, "damping", 0.05)
    spec.option.timestep = 0.002
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    model = spec.compile()
    low, high = model.jnt_range.T
    home = np.clip(np.zeros(len(joints)), low + 0.15 * (high - low), high - 0.15 * (high - low))
    reach = np.minimum(0.35, 0.3 * (high - low))
    return Robot("g1", spec.to_xml(), "fixed", joints, home, reach, None)


ROBOTS = {"pendulum": pendulum, "arm2": arm2, "arm6": arm6, "quadruped": quadruped, "g1": g1}
