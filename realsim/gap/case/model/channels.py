"""Scalars that simulator and log share and that are compared, and reasons for the others."""

from dataclasses import dataclass

from realsim.core.types import MjModel
from realsim.gap.case.case import Case
from realsim.gap.case.model.context import base_body

UNITS = {
    "joint_pos": "rad",
    "joint_vel": "rad/s",
    "joint_torque": "N m",
    "base_pos": "m",
    "base_rot": "rad",
    "imu_gyro": "rad/s",
    "imu_acc": "m/s^2",
}
_SLIDE_UNITS = {"joint_pos": "m", "joint_vel": "m/s", "joint_torque": "N"}


def unit_of(signal: str, label: str, model: MjModel) -> str:
    """Unit of a channel; sliding joints have metres."""
    if signal in _SLIDE_UNITS and int(model.joint(label).type[0]) == 2:
        return _SLIDE_UNITS[signal]
    return UNITS.get(signal, "")


@dataclass(frozen=True)
class Channel:
    """One scalar that simulator and log share."""

    signal: str
    label: str
    """Joint name or axis."""
    index: int
    """Column of the signal."""


def channels(case: Case) -> tuple[Channel, ...]:
    """All that is compared. The base's orientation is compared as a rotation vector, `base_rot`."""
    found = []
    for signal in ("joint_pos", "joint_vel", "joint_torque"):
        if case.has(signal) and not (signal == "joint_torque" and case.torque_kind == "none"):
            found += [Channel(signal, name, i) for i, name in enumerate(case.joint_names)]
    if case.floating and case.has("base_pos"):
        found += [Channel("base_pos", a, i) for i, a in enumerate("xyz")]
        if case.has("base_quat"):
            found += [Channel("base_rot", a, i) for i, a in enumerate("xyz")]
    if case.imu_site:
        for signal in ("imu_gyro", "imu_acc"):
            if case.has(signal):
                found += [Channel(signal, a, i) for i, a in enumerate("xyz")]
    return tuple(found)


def named_place(case: Case, channel: Channel) -> dict[str, str]:
    """{joint}, or {body, axis} for what a base or an inertial unit measures."""
    if channel.signal.startswith("joint"):
        return {"joint": channel.label}
    site = case.imu_site if channel.signal.startswith("imu") else None
    body = int(case.model.site(site).bodyid[0]) if site else base_body(case)
    return {"body": str(case.model.body(body).name), "axis": channel.label}


def uncompared(case: Case) -> list[str]:
    """A sentence for each signal that is in every run and nevertheless not compared."""
    used = {"base_quat" if c.signal == "base_rot" else c.signal for c in channels(case)}
    if case.floating:
        used.add("contact")  # it tells touchdowns, and what bears the robot
    shared = [k for k, v in case.runs[0].signals.items() if v.size and all(k in run.signals for run in case.runs)]
    return [_why_not(case, name) for name in shared if name not in used]


def _why_not(case: Case, signal: str) -> str:
    if not case.has(signal):
        return f"{signal} has no finite sample in some run, so it is not compared"
    if signal == "joint_torque":
        return "joint_torque is not compared: torque_kind in log.json says none, not measured or current_times_constant"
    if signal.startswith("imu"):
        return f"{signal} is not compared: log.json names no imu_site"
    if not case.floating:
        return f"{signal} is not compared: the base is fixed"
    return f"{signal} is neither compared nor taken for the pose that runs begin in: base_pos is not in every run"
