"""Small robots as MJCF: machines of few joints, each with drives of its own kind."""

# Feetech STS3250 with a weight on an arm; the stiffness of its loop in N m/rad is a guess.
SERVO = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="arm" pos="0 0 1"><joint name="servo" axis="0 1 0" armature="0.03" damping="0.8"/>
    <inertial pos="0 0 -0.12" mass="1.13" diaginertia="0.001 0.001 0.001"/></body></worldbody>
  <actuator><position name="servo_loop" joint="servo" kp="25" kv="1" forcerange="-5 5"/></actuator>
</mujoco>"""


def _mjcf(bodies: str, drives: str, more: str = "", step: float = 0.002) -> str:
    return f"""<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{step}" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0" mass="0" size="0.02"/></default>
  <worldbody>{bodies}</worldbody>
  {more}
  <actuator>{drives}</actuator>
</mujoco>
"""


def _link(name: str, joint: str, mass: float, com: str, inertia: str, inner: str = "", pos: str = "0 0 0") -> str:
    return (
        f'<body name="{name}" pos="{pos}">{joint}<inertial pos="{com}" mass="{mass}" diaginertia="{inertia}"/>'
        f'<geom type="sphere"/>{inner}</body>'
    )


def _joint(name: str, axis: str, friction: float, damping: float, armature: float, kind: str = "hinge") -> str:
    return (
        f'<joint name="{name}" type="{kind}" axis="{axis}" frictionloss="{friction}" damping="{damping}" '
        f'armature="{armature}"/>'
    )


def _servo(joint: str, kp: float, kv: float, force: float) -> str:
    return f'<position name="m_{joint}" joint="{joint}" kp="{kp}" kv="{kv}" forcerange="{-force} {force}"/>'


SCARA = _mjcf(
    _link("inner", _joint("j1", "0 0 1", 0.6, 0.8, 0.25), 3.1, "0.14 0 0", "0.006 0.028 0.03",
          _link("outer", _joint("j2", "0 0 1", 0.35, 0.4, 0.08), 2.0, "0.1 0 0", "0.004 0.012 0.013",
                _link("quill", _joint("z", "0 0 1", 4, 20, 1.2, "slide"), 0.55, "0 0 -0.05", "0.001 0.001 0.0002",
                      _link("tool", _joint("yaw", "0 0 1", 0.02, 0.01, 0.002), 0.2, "0.02 0 0", "1e-4 1e-4 1e-4"),
                      pos="0.22 0 0"), pos="0.3 0 0"), pos="0 0 0.6"),
    _servo("j1", 420, 26, 60) + _servo("j2", 190, 10, 35) + _servo("z", 6000, 260, 150) + _servo("yaw", 9, 0.3, 3),
)  # fmt: skip
GRIPPER = _mjcf(
    _link("left", _joint("left_slide", "1 0 0", 0.6, 3, 0.02, "slide"), 0.09, "0 0 -0.03", "2e-5 2e-5 1e-5")
    + _link("right", _joint("right_slide", "-1 0 0", 0.6, 3, 0.02, "slide"), 0.09, "0 0 -0.03", "2e-5 2e-5 1e-5"),
    '<position name="grip" tendon="both" kp="700" kv="24" forcerange="-30 30"/>',
    '<tendon><fixed name="both"><joint joint="left_slide" coef="0.5"/><joint joint="right_slide" coef="0.5"/></fixed>'
    '</tendon><equality><joint joint1="left_slide" joint2="right_slide"/></equality>',
)  # fmt: skip
HEXAPOD = _mjcf(
    _link("coxa", _joint("coxa_yaw", "0 0 1", 0.05, 0.04, 0.006), 0.06, "0.025 0 0", "2e-5 3e-5 3e-5",
          _link("femur", _joint("femur_pitch", "0 1 0", 0.05, 0.04, 0.006), 0.11, "0.05 0 0", "4e-5 1.2e-4 1.2e-4",
                _link("tibia", _joint("tibia_pitch", "0 1 0", 0.05, 0.04, 0.006), 0.09, "0.06 0 0",
                      "2e-5 1.5e-4 1.5e-4", pos="0.1 0 0"), pos="0.05 0 0"), pos="0 0 0.4"),
    "".join(_servo(j, 9, 0.25, 1.6) for j in ("coxa_yaw", "femur_pitch", "tibia_pitch")),
)  # fmt: skip
CARTPOLE = _mjcf(
    _link("cart", _joint("rail", "1 0 0", 1.0, 4.0, 0.3, "slide"), 1.1, "0 0 0", "0.003 0.003 0.003",
          _link("pole", _joint("pin", "0 1 0", 0.002, 0.003, 0.0), 0.21, "0 0 -0.24", "0.005 0.005 1e-4")),
    '<motor name="belt" joint="rail" ctrlrange="-40 40"/>',
)  # fmt: skip
GANTRY = _mjcf(
    _link("bridge", _joint("x", "1 0 0", 12, 60, 4, "slide"), 9.0, "0 0 0", "0.5 0.2 0.5",
          _link("trolley", _joint("y", "0 1 0", 7, 35, 2, "slide"), 3.5, "0 0 0", "0.02 0.02 0.02",
                _link("ram", _joint("z", "0 0 1", 9, 50, 5, "slide"), 2.2, "0 0 -0.2", "0.03 0.03 0.002"))),
    _servo("x", 26000, 1200, 600) + _servo("y", 13000, 520, 300) + _servo("z", 15000, 560, 260),
)  # fmt: skip
ELASTIC = _mjcf(
    _link("rotor", _joint("motor", "0 1 0", 0.3, 0.2, 0.09), 0.4, "0 0 0", "3e-4 3e-4 3e-4",
          _link("arm", '<joint name="spring" axis="0 1 0" stiffness="40" damping="0.15"/>', 1.3, "0 0 -0.2",
                "0.02 0.02 0.001"), pos="0 0 1"),
    _servo("motor", 160, 5, 30),
)  # fmt: skip
TURRET = _mjcf(
    _link("ring", _joint("pan", "0 0 1", 0.4, 0.3, 0.1), 2.4, "0.02 0 0.05", "0.02 0.02 0.025",
          _link("cradle", _joint("tilt", "0 1 0", 0.2, 0.15, 0.04), 1.5, "0.06 0 0.01", "0.004 0.008 0.008",
                pos="0 0 0.15")),
    '<velocity name="m_pan" joint="pan" kv="9" forcerange="-12 12"/>'
    '<velocity name="m_tilt" joint="tilt" kv="6" forcerange="-8 8"/>',
)  # fmt: skip
DIRECT = _mjcf(
    _link("thigh", _joint("hip", "0 1 0", 0.12, 0.05, 0.012), 1.4, "0 0 -0.1", "0.008 0.008 0.001",
          _link("shank", _joint("knee", "0 1 0", 0.1, 0.05, 0.012), 0.5, "0 0 -0.11", "0.004 0.004 2e-4",
                pos="0 0 -0.25"), pos="0 0 1"),
    '<motor name="m_hip" joint="hip" ctrlrange="-20 20"/><motor name="m_knee" joint="knee" ctrlrange="-20 20"/>',
)  # fmt: skip
CRANE = _mjcf(
    _link("tower", _joint("slew", "0 0 1", 2, 3, 1.5), 6, "0.2 0 0", "0.2 0.4 0.5",
          _link("carriage", _joint("reach", "1 0 0", 3, 20, 1, "slide"), 1.0, "0 0 0", "0.002 0.002 0.002",
                _link("load", _joint("sway", "0 1 0", 0.0, 0.004, 0.0), 0.8, "0 0 -0.5", "0.003 0.003 0.002"),
                pos="0.4 0 0"), pos="0 0 1.5"),
    _servo("slew", 500, 60, 80) + _servo("reach", 3000, 220, 120),
)  # fmt: skip
WRIST = _mjcf(
    _link("roll_link", _joint("roll", "1 0 0", 0.08, 0.06, 0.01), 0.5, "0.03 0 0", "4e-4 6e-4 6e-4",
          _link("pitch_link", _joint("pitch", "0 1 0", 0.08, 0.06, 0.01), 0.4, "0.05 0 0", "2e-4 5e-4 5e-4",
                _link("flange", _joint("turn", "1 0 0", 0.04, 0.03, 0.005), 0.3, "0.06 0 0.015", "1e-4 2e-4 2e-4",
                      pos="0.08 0 0"), pos="0.07 0 0"), pos="0 0 0.8"),
    _servo("roll", 60, 1.6, 9) + _servo("pitch", 60, 1.6, 9) + _servo("turn", 25, 0.6, 4),
)  # fmt: skip
_TOUCHES = 'contype="1" conaffinity="1"'
_WHEEL = f'<geom type="sphere" size="0.08" {_TOUCHES} friction="0.9 0.01 0.001"/>'
ROVER = _mjcf(
    f'<geom name="floor" type="plane" size="20 20 0.1" {_TOUCHES}/><body name="chassis" pos="0 0 0.08"><freejoint/>'
    '<inertial pos="-0.03 0 0.06" mass="9" diaginertia="0.12 0.15 0.2"/>'
    f'<geom type="sphere" size="0.03" pos="-0.22 0 -0.05" {_TOUCHES} friction="0.02 0.001 0.001"/>'
    + _link("left_wheel", _joint("left", "0 1 0", 0.1, 0.05, 0.01), 0.6, "0 0 0", "0.001 0.002 0.001", _WHEEL,
            pos="0 0.2 0")
    + _link("right_wheel", _joint("right", "0 1 0", 0.1, 0.05, 0.01), 0.6, "0 0 0", "0.001 0.002 0.001", _WHEEL,
            pos="0 -0.2 0") + "</body>",
    '<velocity name="m_left" joint="left" kv="3" forcerange="-5 5"/>'
    '<velocity name="m_right" joint="right" kv="3" forcerange="-5 5"/>',
)  # fmt: skip
