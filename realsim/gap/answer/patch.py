"""The diagnosis as changes to a simulator: for plain MuJoCo, for the trainer, and as MJCF where MJCF can say it."""

from __future__ import annotations

from math import log1p
from pathlib import Path
from typing import Any

from realsim.errors import GapError, UnknownNameError
from realsim.gap.causes.fit import Fit
from realsim.gap.effects import EFFECTS
from realsim.gap.logs.case import Case
from realsim.gap.logs.resolve import resolve
from realsim.gap.model.context import Context, build_context
from realsim.gap.model.edit import Edit, Signals
from realsim.gap.simulation.simulate import Setting, Simulator

FORMAT, EARLIER = "realsim.gap.patch/2", "realsim.gap.patch/1"
LOGARITHMIC = ("stiffness_gain", "damping_gain", "motor_gain")
"""Effects whose ratio was less 1 in the earlier format and is a logarithm now."""
# What no compiled model holds, and what the loop that steps it must do about it.
_WRAPPER = {
    "command_delay": "hold back every command by this time before it is written to ctrl (model.xml does it itself, but "
    "for a delay below 0)",
    "observation_delay": "read joint positions, velocities and torques this much later",
    "joint_offset": "add it to the joint's reading, and give the servo the command less it (times the actuator's gear; "
    "for position servos model.xml does this)",
    "reading_offset": "add it to the joint's reading; the servo is right",
    "gyro_bias": "add it to the gyroscope's reading",
    "acc_bias": "add it to the accelerometer's reading",
    "load_friction": "before each step, set dof_frictionloss to the model's plus ratio * |torque of the drive|",
    "position_torque": "before each step, set the joint's qfrc_applied to constant + cos_1 cos(q) + sin_1 sin(q) + "
    "cos_2 cos(2 q) + sin_2 sin(2 q); the values stand in this order",
    "external_force": "set ctrl of this actuator to 1 from start to end (of the run, or since its onset), else to 0",
}
_IN_XML = ("command_delay", "joint_offset")
"""Wrappers that the patched model.xml does without."""


def empty_patch() -> dict[str, Any]:
    """A patch that changes nothing."""
    return {"format": FORMAT, "settings": [], "wrappers": {}}


def make_patch(simulator: Simulator, fit: Fit) -> dict[str, Any]:
    """A patch as plain data, to be applied with `apply_patch`.

    `settings` are the effects in their own coordinates, `scales` the figures of the nominal runs that these refer to
    (so that the log is not needed), `wrappers` what no compiled model can hold, for the loop that steps the simulator,
    and `how` says for each effect which of the two it is.
    """
    settings = fit.settings()
    signals = simulator.edited(settings).signals
    return {
        "format": FORMAT,
        "command_kind": simulator.case.command_kind,
        "settings": [
            {"effect": n, "place": list(p), "coordinates": {k: float(v) for k, v in values.items()}}
            for n, p, values in settings
        ],
        "scales": _scales(simulator.context),
        "wrappers": wrappers(signals, simulator.onsets),
        "how": [_how(simulator, setting) for setting in settings],
    }


def _how(simulator: Simulator, setting: Setting) -> dict[str, Any]:
    name, place, _ = setting
    passing = any(not p.always for p in simulator.edited([setting]).signals.pulses)
    means = "model" if EFFECTS[name].patchable and not passing else "wrapper"
    return {"effect": name, "place": list(place), "means": means}


def wrappers(signals: Signals, onsets: dict[str, float] | None = None) -> dict[str, Any]:
    """Only what differs from nothing: {value, unit, what to do}; `onsets`: those of the runs, s."""
    found: dict[str, Any] = {}
    for name in ("command_delay", "observation_delay"):
        value = getattr(signals, name)
        if value:
            found[name] = {"value": float(value), "unit": "s"}
    for name, values in (("joint_offset", signals.joint_offset), ("reading_offset", signals.read_offset)):
        if any(values.values()):
            found[name] = {"value": {j: float(v) for j, v in values.items() if v}, "unit": "rad"}
    if any(signals.gyro_bias):
        found["gyro_bias"] = {"value": list(signals.gyro_bias), "unit": "rad/s"}
    if any(signals.acc_bias):
        found["acc_bias"] = {"value": list(signals.acc_bias), "unit": "m/s^2"}
    if signals.position_torque:
        found["position_torque"] = {"value": dict(signals.position_torque), "unit": "N m"}
    if signals.load_friction:
        found["load_friction"] = {"value": dict(signals.load_friction), "unit": "ratio"}
    passing = [p for p in signals.pulses if not p.always]
    if passing:
        value = [
            {"actuator": p.actuator, "start_s": p.start, "end_s": p.end, "since_onset": p.by_onset} for p in passing
        ]
        found["external_force"] = {"value": value, "unit": "s"}
        if any(p.by_onset for p in passing):
            found["external_force"]["onsets_s"] = dict(onsets or {})
    return {name: {**said, "what": _WRAPPER[name]} for name, said in found.items()}


def _scales(context: Context) -> dict[str, Any]:
    """The figures of the nominal runs that coordinates refer to, so that a patch can be applied without the log."""
    names = ("peak_torque", "speed", "mean_torque", "mean_speed", "torque_range", "inertia")
    return {name: dict(getattr(context, name)) for name in names}


def apply_patch(spec: Any, patch: dict[str, Any]) -> Signals:
    """Change a mujoco.MjSpec of the nominal model in place; returns the wrappers that the stepping loop must add.

    Args:
        spec: MjSpec of the model that was diagnosed (names must match). Compile it afterwards.
        patch: `patch` of diagnosis.json.

    Raises:
        GapError: for a patch of another format, or a model without the named parts.
    """
    patch = _upgraded(patch)
    if not isinstance(patch, dict) or patch.get("format") != FORMAT:
        raise GapError(
            "not a patch of this version",
            expected=f'"format": "{FORMAT}"',
            found=repr(patch)[:80],
            hint="diagnose the case again: a patch is read by the version that wrote it",
        )
    if not patch.get("settings"):
        return Signals()
    resolve(spec)
    model = spec.copy().compile()
    joints = tuple(patch["scales"]["torque_range"])
    _belongs(model, patch, joints)
    actuators = tuple(model.actuator(i).name for i in range(model.nu))
    base = "floating" if bool((model.jnt_type == 0).any()) else "fixed"
    kind = patch.get("command_kind", "position")  # older patches do not say
    case = Case(
        Path(), joints, actuators, kind, base, "none", None, (), "", "", spec, model, (),
    )  # fmt: skip
    context = build_context(case)
    for name, values in patch["scales"].items():
        getattr(context, name).update(values)
    edit = Edit(context)
    edit._spec = spec  # in place: the caller's spec is what shall change
    for item in patch["settings"]:
        effect = EFFECTS[item["effect"]]
        place = tuple(item["place"])
        full = {p.name: p.default for p in effect.parameters(context, place)}
        effect.apply(edit, place, full | item["coordinates"])
    _hold_forces(edit)
    if edit.signals.rotors:
        for key in list(spec.keys):
            spec.delete(key)  # a keyframe has the old number of coordinates
    return edit.signals


def _upgraded(patch: Any) -> Any:
    """A patch of the earlier format as one of this; anything else as it is."""
    if not isinstance(patch, dict) or patch.get("format") != EARLIER:
        return patch
    settings = [
        {**item, "coordinates": {name: log1p(value) for name, value in item["coordinates"].items()}}
        if item["effect"] in LOGARITHMIC
        else item
        for item in patch.get("settings", [])
    ]
    return {**patch, "format": FORMAT, "settings": settings}


def _belongs(model: Any, patch: dict[str, Any], joints: tuple[str, ...]) -> None:
    """All that a patch names must be in the model."""
    known = {
        "joint": {model.joint(i).name for i in range(model.njnt)},
        "body": {model.body(i).name for i in range(model.nbody)},
    }
    for joint in joints:
        if joint not in known["joint"]:
            raise GapError("the patch belongs to another model", found=f"no joint {joint!r}")
    for item in patch["settings"]:
        scope = EFFECTS[item["effect"]].scope
        kind = "joint" if scope == "joint" else "body"
        for name in item["place"] if scope != "global" else ():
            if name not in known[kind]:
                raise UnknownNameError(f"{kind} of the patch", name, known[kind])


def _hold_forces(edit: Edit) -> None:
    """A force that acts always needs no control: its actuator has it as a constant."""
    import mujoco

    for pulse in [p for p in edit.signals.pulses if p.always]:
        actuator = edit.spec.actuator(pulse.actuator)
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        bias, gain = actuator.biasprm, actuator.gainprm
        bias[0], gain[0] = 1.0, 0.0
        actuator.biasprm, actuator.gainprm = bias, gain
        edit.signals.pulses.remove(pulse)


def patched_xml(simulator: Simulator, fit: Fit) -> str:
    """model.xml with the causes in it, as far as MJCF can express them; a comment names what it cannot."""
    spec = simulator.case.spec.copy()
    signals = apply_patch(spec, make_patch(simulator, fit))
    context = simulator.context
    if signals.command_delay > 0:
        for name in simulator.case.actuator_names:
            actuator = spec.actuator(name)
            steps = int(signals.command_delay / context.timestep) + 2
            actuator.delay, actuator.nsample = signals.command_delay, steps
    for joint, offset in signals.joint_offset.items():
        if simulator.case.command_kind == "position" and offset:
            actuator = spec.actuator(context.actuator[joint])
            bias = actuator.biasprm
            bias[0] -= actuator.gainprm[0] * simulator.case.gear(joint) * offset
            actuator.biasprm = bias
    spec.compile()
    left = [name for name in wrappers(signals) if name not in _IN_XML or _beyond_xml(name, simulator, signals)]
    note = f"<!-- not in this file, see patch.wrappers in diagnosis.json: {', '.join(left)} -->\n" if left else ""
    return note + str(spec.to_xml())


def _beyond_xml(wrapper: str, simulator: Simulator, signals: Signals) -> bool:
    if wrapper == "command_delay":
        return signals.command_delay <= 0
    return wrapper == "joint_offset" and simulator.case.command_kind != "position"


def asset_files(spec: Any) -> list[str]:
    """Paths of the files that a model reads (meshes, textures, height fields), relative to its folder."""
    folders = ((spec.meshes, spec.meshdir), (spec.textures, spec.texturedir), (spec.hfields, spec.meshdir))
    return sorted({str(Path(folder) / item.file) for items, folder in folders for item in items if item.file})
