"""The diagnosis as changes to a simulator: for plain MuJoCo, for the trainer, and as MJCF where MJCF can say it."""

from __future__ import annotations

from typing import Any

from realsim.errors import GapError
from realsim.gap.context import Context
from realsim.gap.edit import Edit, Signals
from realsim.gap.effects import EFFECTS
from realsim.gap.fit import Fit
from realsim.gap.simulate import Simulator, lookup


def make_patch(simulator: Simulator, fit: Fit) -> dict[str, Any]:
    """A patch as plain data: absolute new values of the model's fields, added parts, and wrappers in time.

    `edits` is a list of {"op", ...}; see `apply_patch`. `wrappers` is what no model can express (delays, encoder
    zeros, biases), for the loop that steps the simulator.
    """
    settings = fit.settings()
    edit = simulator.edited(settings)
    return {
        "format": "realsim.gap.patch/1",
        "settings": [
            {"effect": n, "place": list(p), "coordinates": {k: float(v) for k, v in values.items()}}
            for n, p, values in settings
        ],
        "scales": _scales(simulator.context),
        "wrappers": wrappers(edit.signals),
    }


def wrappers(signals: Signals) -> dict[str, Any]:
    """Only what differs from nothing."""
    found: dict[str, Any] = {}
    for name in ("command_delay", "observation_delay"):
        value = getattr(signals, name)
        if value:
            found[name] = {"value": float(value), "unit": "s"}
    offsets = {j: v for j, v in signals.joint_offset.items() if v}
    if offsets:
        found["joint_offset"] = {"value": offsets, "unit": "rad", "what": "reading minus truth; the servo reads it too"}
    readings = {j: v for j, v in signals.read_offset.items() if v}
    if readings:
        found["reading_offset"] = {"value": readings, "unit": "rad", "what": "reading minus truth, in the log only"}
    if any(signals.gyro_bias):
        found["gyro_bias"] = {"value": list(signals.gyro_bias), "unit": "rad/s"}
    if any(signals.acc_bias):
        found["acc_bias"] = {"value": list(signals.acc_bias), "unit": "m/s^2"}
    if signals.load_friction:
        found["load_friction"] = {
            "value": dict(signals.load_friction),
            "unit": "ratio",
            "what": "each step, control of actuator load_friction_JOINT = -ratio * |drive torque| * sign(velocity)",
        }
    if signals.pulses:
        found["external_force"] = [{"actuator": n, "start_s": s, "end_s": e} for n, s, e in signals.pulses]
    return found


def _scales(context: Context) -> dict[str, Any]:
    """The figures of the nominal runs that coordinates refer to, so that a patch can be applied without the log."""
    return {
        "peak_torque": context.peak_torque,
        "speed": context.speed,
        "mean_torque": context.mean_torque,
        "mean_speed": context.mean_speed,
        "torque_range": context.torque_range,
        "inertia": context.inertia,
    }


def apply_patch(spec: Any, patch: dict[str, Any]) -> Signals:
    """Change a mujoco.MjSpec of the nominal model in place; returns the wrappers that the stepping loop must add.

    Args:
        spec: MjSpec of the model that was diagnosed (names must match). Compile it afterwards.
        patch: `patch` of diagnosis.json.

    Raises:
        GapError: for a patch of another format, or a model without the named parts.
    """
    from realsim.gap.case import Case
    from realsim.gap.context import build_context

    if not isinstance(patch, dict) or patch.get("format") != "realsim.gap.patch/1":
        raise GapError("not a patch of this tool", expected='"format": "realsim.gap.patch/1"')
    model = spec.copy().compile()
    joints = tuple(j for j in patch["scales"]["torque_range"])
    missing = [j for j in joints if j not in {model.joint(i).name for i in range(model.njnt)}]
    if missing:
        raise GapError("the patch belongs to another model", found=f"no joint {missing[0]!r}")
    floating = bool((model.jnt_type == 0).any())
    actuators = tuple(model.actuator(i).name for i in range(model.nu))
    from pathlib import Path

    case = Case(
        Path(), joints, actuators, "position", "floating" if floating else "fixed", "none", None, (), "", "",
        spec, model, (),
    )  # fmt: skip
    context = build_context(case)
    for name, values in patch["scales"].items():
        getattr(context, name).update(values)
    edit = Edit(context)
    edit._spec = spec
    for item in patch["settings"]:
        effect = EFFECTS[item["effect"]]
        place = tuple(item["place"])
        full = {p.name: p.default for p in effect.parameters(context, place)}
        effect.apply(edit, place, full | item["coordinates"])
    return edit.signals


def patched_xml(simulator: Simulator, fit: Fit) -> str:
    """model.xml with the causes in it, as far as MJCF can express them; a comment names what it cannot."""
    spec = simulator.case.spec.copy()
    context = simulator.context
    edit = Edit(context)
    edit._spec = spec
    for name, place, values in fit.settings():
        effect = lookup(name)
        full = {p.name: p.default for p in effect.parameters(context, place)}
        effect.apply(edit, place, full | values)
    if len(spec.keys) and edit.signals.rotors:
        for key in list(spec.keys):
            spec.delete(key)  # a keyframe has the old number of coordinates
    if edit.signals.command_delay > 0:
        for actuator in spec.actuators:
            steps = int(edit.signals.command_delay / context.timestep) + 2
            actuator.delay, actuator.nsample = edit.signals.command_delay, steps
    for joint, offset in edit.signals.joint_offset.items():
        if simulator.case.command_kind == "position" and offset:
            actuator = spec.actuator(context.actuator[joint])
            bias = actuator.biasprm
            bias[0] -= actuator.gainprm[0] * offset
            actuator.biasprm = bias
    spec.compile()
    text = str(spec.to_xml())
    left = wrappers(edit.signals)
    left.pop("command_delay", None)
    left.pop("joint_offset", None)
    note = f"<!-- not in this file, see patch.wrappers in diagnosis.json: {', '.join(left)} -->\n" if left else ""
    return note + text
