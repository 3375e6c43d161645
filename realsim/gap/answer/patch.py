"""The diagnosis as changes to a simulator: for plain MuJoCo, for the trainer, and as MJCF where MJCF can say it."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import log1p
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, UnknownNameError
from realsim.core.types import MjModel, MjSpec
from realsim.gap.case.case import Case
from realsim.gap.case.model.context import Context, build_context
from realsim.gap.case.model.edit import Edit, Signals, put
from realsim.gap.case.resolve import resolve
from realsim.gap.effects import EFFECTS
from realsim.gap.simulation.simulate import Setting, Simulator

FORMAT, EARLIER = "realsim.gap.patch/2", "realsim.gap.patch/1"
"""In the earlier one what is a ratio's logarithm now was the ratio less 1."""
PULSES = "external_force"
"""Wrapper of forces that act for a while."""


def empty_patch() -> dict[str, Any]:
    """A patch that changes nothing."""
    return {"format": FORMAT, "settings": [], "wrappers": {}}


def make_patch(
    simulator: Simulator, settings: Sequence[Setting], onsets: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """A patch as plain data, to be applied with `apply_patch`.

    `settings` are the effects in their own coordinates, `scales` the figures of the nominal runs that these refer to
    (so that the log is not needed), `wrappers` what no compiled model can hold, for the loop that steps the simulator,
    and `how` says for each effect which of the two it is. `onsets`: see `Simulator.edited`.
    """
    signals = simulator.edited(settings).signals
    return {
        "format": FORMAT,
        "command_kind": simulator.case.command_kind,
        "settings": [
            {"effect": n, "place": list(p), "coordinates": {k: float(v) for k, v in values.items()}}
            for n, p, values in settings
        ],
        "scales": _scales(simulator.context),
        "wrappers": wrappers(signals, onsets),
        "how": [_how(simulator, setting) for setting in settings],
    }


def _how(simulator: Simulator, setting: Setting) -> dict[str, Any]:
    name, place, _ = setting
    passing = any(not p.always for p in simulator.edited([setting]).signals.pulses)
    means = "model" if EFFECTS[name].patchable and not passing else "wrapper"
    return {"effect": name, "place": list(place), "means": means}


def wrappers(signals: Signals, onsets: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Only what differs from nothing: {value, unit, what to do}; `onsets`: those of the runs, s."""
    found: dict[str, Any] = {}
    for wrapper in fields(signals):
        value = getattr(signals, wrapper.name)
        if wrapper.metadata and any(value.values() if isinstance(value, dict) else np.atleast_1d(value)):
            found[wrapper.name] = {"value": _plain(value), **wrapper.metadata}
    passing = [p for p in signals.pulses if not p.always]
    if passing:
        value = [
            {"actuator": p.actuator, "start_s": p.start, "end_s": p.end, "since_onset": p.by_onset} for p in passing
        ]
        what = "set ctrl of this actuator to 1 from start to end (of the run, or since its onset), else to 0"
        found[PULSES] = {"value": value, "unit": "s", "what": what}
        if any(p.by_onset for p in passing):
            found[PULSES]["onsets_s"] = dict(onsets or {})
    return found


def _plain(value: Any) -> Any:
    """As JSON has it; of joints, those that have something."""
    if isinstance(value, dict):
        return {name: _plain(v) for name, v in value.items() if v}
    return [float(v) for v in value] if isinstance(value, Sequence) else float(value)


def _scales(context: Context) -> dict[str, Any]:
    """The figures of the nominal runs that coordinates refer to, so that a patch can be applied without the log."""
    names = ("peak_torque", "speed", "mean_torque", "mean_speed", "torque_range", "inertia")
    return {name: dict(getattr(context, name)) for name in names}


def apply_patch(spec: MjSpec, patch: dict[str, Any]) -> Signals:
    """Change a mujoco.MjSpec of the nominal model in place; returns the wrappers that the stepping loop must add.

    Args:
        spec: MjSpec of the model that was diagnosed (names must match). Compile it afterwards.
        patch: `patch` of diagnosis.json.

    Raises:
        GapError: for a patch of another format, or a model without the named parts.
    """
    if not isinstance(patch, dict) or patch.get("format") not in (FORMAT, EARLIER):
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
    edit = Edit(context, spec)
    for item in patch["settings"]:
        effect = EFFECTS[item["effect"]]
        place = tuple(item["place"])
        parameters = effect.parameters(context, place)
        given = {p.name: item["coordinates"].get(p.name, p.default) for p in parameters}
        if patch["format"] == EARLIER:
            given |= {p.name: log1p(given[p.name]) for p in parameters if p.logarithmic}
        effect.apply(edit, place, given)
    _hold_forces(edit)
    _hold_lags(edit)
    if edit.signals.rotors:
        for key in list(spec.keys):
            spec.delete(key)  # a keyframe has the old number of coordinates
    return edit.signals


def _belongs(model: MjModel, patch: dict[str, Any], joints: tuple[str, ...]) -> None:
    """All that a patch names must be in the model."""
    known = {
        "joint": {model.joint(i).name for i in range(model.njnt)},
        "body": {model.body(i).name for i in range(model.nbody)},
        "actuator": {model.actuator(i).name for i in range(model.nu)},
    }
    for joint in joints:
        if joint not in known["joint"]:
            raise GapError("the patch belongs to another model", found=f"no joint {joint!r}")
    for item in patch["settings"]:
        scope = EFFECTS[item["effect"]].scope
        kind = scope if scope in known else "body"
        for name in item["place"] if scope != "global" else ():
            if name not in known[kind]:
                raise UnknownNameError(f"{kind} of the patch", name, known[kind])


def _hold_forces(edit: Edit) -> None:
    """A force that acts always needs no control: its actuator has it as a constant."""
    import mujoco

    for pulse in [p for p in edit.signals.pulses if p.always]:
        actuator = edit.spec.actuator(pulse.actuator)
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        put(actuator, "biasprm", 0, 1.0)
        put(actuator, "gainprm", 0, 0.0)
        edit.signals.pulses.remove(pulse)


def _hold_lags(edit: Edit) -> None:
    """A lag of the actuators is their activation's."""
    import mujoco

    for name, own in edit.context.case.lags.items() if edit.signals.actuator_lag else ():
        actuator, lag = edit.spec.actuator(name), own + edit.signals.actuator_lag
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT if lag > 0 else mujoco.mjtDyn.mjDYN_NONE
        actuator.actearly = 1  # the force of a step is that of its control
        put(actuator, "dynprm", 0, max(lag, 0.0))
    edit.signals.actuator_lag = 0.0


def patched_xml(simulator: Simulator, settings: Sequence[Setting]) -> str:
    """model.xml with the causes in it, as far as MJCF can express them; a comment names what it cannot."""
    spec = simulator.case.spec.copy()
    signals = apply_patch(spec, make_patch(simulator, settings))
    context = simulator.context
    if signals.command_delay > 0:
        for name in simulator.case.actuator_names:
            actuator = spec.actuator(name)
            steps = int(signals.command_delay / context.timestep) + 2
            actuator.delay, actuator.nsample = signals.command_delay, steps
        signals.command_delay = 0.0
    if simulator.case.command_kind == "position":
        for joint, offset in signals.joint_offset.items():
            actuator = spec.actuator(context.actuator[joint])
            shift = actuator.gainprm[0] * simulator.case.gear(joint) * offset
            put(actuator, "biasprm", 0, actuator.biasprm[0] - shift)
        signals.joint_offset = {}
    spec.compile()
    left = list(wrappers(signals))
    note = f"<!-- not in this file, see patch.wrappers in diagnosis.json: {', '.join(left)} -->\n" if left else ""
    return note + str(spec.to_xml())


def asset_files(spec: MjSpec) -> list[str]:
    """Paths of the files that a model reads (meshes, textures, height fields), relative to its folder."""
    folders = ((spec.meshes, spec.meshdir), (spec.textures, spec.texturedir), (spec.hfields, spec.meshdir))
    return sorted({str(Path(folder) / item.file) for items, folder in folders for item in items if item.file})
