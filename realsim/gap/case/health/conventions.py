"""Wrong units, order or sign: each is tested against the commands, the other signals and the nominal simulator.

A mistake that is plain is refused, with what to write in log.json: a diagnosis of a log that is read wrongly would
name causes with great confidence. One that is only likely is a warning.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from realsim.core.errors import GapError
from realsim.core.statistics import alike
from realsim.core.types import F64
from realsim.gap.case.case import Case
from realsim.gap.case.motion import sample_noise
from realsim.gap.case.units import TORQUE, gravity_unit, speed_factor, travelled
from realsim.gap.simulation.simulate import Simulator, rotation_from

PLAIN = 0.35
"""Relative error up to which a log that is read otherwise agrees."""
WRONG = 0.8
"""Relative error from which a log as it is read does not agree at all."""
FEW_JOINTS = 3
"""Joints that must go astray before the model is refused: one or two may well have the gap that is looked for."""
MOVES, LITTLE = 10.0, 1e-3
"""Motion in units of a sample's noise, or of so many rad or m where that is less, from which a column's course shows
whose it is: in a log of 8 mrad play and stiction made joints look exchanged. Not tuned."""
LIKE = 0.8
"""Cosine from which two torques have the same course."""
DEG = 180 / np.pi


def log_conventions(case: Case) -> list[str]:
    """Checks of commands and signals against each other, before any simulation."""
    position = _all(case, "joint_pos")
    commands = {joint: command for joint in case.joint_names if (command := _commanded(case, joint)) is not None}
    ways = []
    for j, joint in enumerate(case.joint_names):
        if joint in commands:
            _refuse_unit(case, "joint_pos", joint, position[:, j], commands[joint], {"deg": DEG}, "the commands")
            servo = str(case.actuator_of(joint))
            _refuse_unit(case, "command", servo, commands[joint], position[:, j], {"deg": DEG}, "the positions")
        if case.has("joint_vel"):
            runs = [(r.time, r.signals["joint_pos"][:, j], r.signals["joint_vel"][:, j]) for r in case.runs]
            ways.append([travelled(*run) for run in runs])
            moved, sums = (np.concatenate(parts) for parts in zip(*ways[j], strict=True))
            found = speed_factor(moved, sums)
            wrong = "-1" if found.ratio < 0 and found.unit == "rad/s" else found.unit
            if abs(found.corr) > LIKE and found.near and wrong != "rad/s":
                raise _misread(case, "joint_vel", joint, wrong, abs(found.ratio), "the positions' slope")
    return _runs_apart(case, position, commands, ways) + _base(case)


def nominal_conventions(simulator: Simulator, nominal: list[F64]) -> list[str]:
    """Checks of the log's units, order and signs against the nominal simulator."""
    case, names = simulator.case, simulator.case.joint_names
    real, model = _all(case, "joint_pos"), np.concatenate([y[:, : len(names)] for y in nominal])
    follows = []
    for j, joint in enumerate(names):
        command = _commanded(case, joint)
        follows.append(command is not None and 0 < disagreement(real[:, j], command) < WRONG)
        if not follows[j]:  # else it does what it is commanded, and it is the simulator that does not
            scales = {"deg": DEG, "-1": -1.0}
            _refuse_unit(case, "joint_pos", joint, real[:, j], model[:, j], scales, "the nominal simulator")
    _refuse_order_and_model(case, real, model, follows)
    found = _likely(names, real, model, follows)
    if lag := simulator.velocity_lag:
        found.append(f"joint_vel is the positions' slope through a filter of {1e3 * lag:.0f} ms: so is the simulator's")
    if case.has("joint_torque"):
        found += _torque_units(simulator, nominal)
    return found + _imu(simulator, nominal)


# ---------------------------------------------------------------- plain mistakes


def _refuse_unit(
    case: Case, array: str, name: str, values: F64, like: F64, scales: Mapping[str, float], witness: str
) -> None:
    """Raise where values / scale agree with what they should be like, and values do not."""
    if disagreement(values, like) < WRONG:
        return
    for unit, scale in scales.items():
        if disagreement(values / scale, like) < PLAIN:
            raise _misread(case, array, name, unit, abs(scale), witness)


def _misread(case: Case, array: str, name: str, unit: str, ratio: float, witness: str) -> GapError:
    """The error for an array, or a part of it, in another unit (`-1`: of the other sign)."""
    found = "the opposite sign agrees" if unit == "-1" else f"values {ratio:.3g} times as large"
    expected = f"agreement with {witness}, in the contract's units and signs"
    return _refusal(case, f"{array} of {name}", array, unit, expected, found)


def _refusal(case: Case, what: str, array: str, unit: str, expected: str, found: str) -> GapError:
    turned = unit == "-1"
    return GapError(
        f"{what} looks {'negated' if turned else f'like {unit}'}", file=case.folder, expected=expected, found=found,
        hint='fix the log, or give "sign": -1 for the column in columns.json (.csv)' if turned
        else f'write "units": {{"{array}": "{unit}"}} in log.json (.npz), or a unit in columns.json (.csv)',
    )  # fmt: skip


def disagreement(values: F64, like: F64) -> float:
    """Root mean square of the difference over that of `like`, both without their means; 0 where nothing moves."""
    good = np.isfinite(values) & np.isfinite(like)
    if good.sum() < 20:
        return 0.0
    a, b = values[good] - values[good].mean(), like[good] - like[good].mean()
    size = float(np.sqrt(np.mean(b**2)))
    return float(np.sqrt(np.mean((a - b) ** 2))) / size if size > 1e-3 else 0.0


def _runs_apart(
    case: Case, position: F64, commands: Mapping[str, F64], ways: Sequence[Sequence[tuple[F64, F64]]]
) -> list[str]:
    """Runs unlike the others: velocities that have nothing to do with their positions, commands of the other sign.

    Args:
        ways: of each joint and run, the way travelled and the velocity's integrals; none where no velocity is logged.
    """
    ends = np.cumsum([len(r.time) for r in case.runs])[:-1]
    names = [r.name for r in case.runs]
    found = []
    for j, joint in enumerate(case.joint_names):
        if ways:
            apart = np.array([disagreement(sums, moved) for moved, sums in ways[j]])
            moved = np.array([np.std(m[np.isfinite(m)]) if np.isfinite(m).any() else 0.0 for m, _ in ways[j]])
            odd = (apart > WRONG) & (moved > np.median(moved) / 2)  # slow motion drowns in noise
            if np.median(apart) < PLAIN:
                text = f"joint_vel of {joint} is not the slope of its positions; in other runs it is"
                found += [f"{names[i]}: {text}" for i in np.flatnonzero(odd)]
        if joint in commands:
            runs = zip(np.split(position[:, j], ends), np.split(commands[joint], ends), strict=True)
            match = np.array([alike(p, command) for p, command in runs])
            if np.median(match) > 0:
                text = f"the command of {case.actuator_of(joint)} looks negated; in other runs it does not"
                found += [f"{names[i]}: {text}" for i in np.flatnonzero(match < -LIKE)]
    return found


def _commanded(case: Case, joint: str) -> F64 | None:
    """(N,) where a position servo's commands want its joint, rad or m; NaN while the drive is off. None without one."""
    servo = case.actuator_of(joint)
    if servo is None or case.command_kind != "position":
        return None
    u = case.actuator_names.index(servo)
    command = np.concatenate([np.where(r.on[:, u], r.command[:, u], np.nan) for r in case.runs])
    return command / (case.gear(joint) or 1.0)


def _refuse_order_and_model(case: Case, real: F64, model: F64, follows: Sequence[bool]) -> None:
    """Refuse columns that agree with another joint's simulation and not with their own; and a model most of whose
    joints go elsewhere than the robot's, which go where they are commanded to."""
    names = case.joint_names
    like, astray = dict[int, int](), []
    own = [disagreement(real[:, j], model[:, j]) for j in range(len(names))]
    for j, name in enumerate(names):
        if follows[j]:
            astray += [name] if disagreement(model[:, j], real[:, j]) > WRONG else []
        elif own[j] >= WRONG and np.nanstd(real[:, j]) > MOVES * max(sample_noise(case, j), LITTLE):
            others = [disagreement(real[:, j], model[:, k]) or np.inf for k in range(len(names))]
            if others[best := int(np.argmin(others))] < PLAIN:
                like[j] = best
    # An exchange explains more only where the joint that a column moves like has a column that is not its own, either.
    moved = [f"the column of {names[j]} moves like {names[k]}" for j, k in like.items() if own[k] >= WRONG]
    if moved:
        raise GapError(
            "positions and commands are in different orders of joints", file=case.folder / "log.json",
            found="; ".join(moved[:6]),
            hint="one of joint_names (of joint_pos) and actuator_names (of command) is not in its columns' order: "
            "mend that one, not both; `realsim log RECORDING --model model.xml` decides it by names",
        )  # fmt: skip
    if len(astray) >= FEW_JOINTS and len(astray) > 0.5 * len(names):
        raise GapError(
            "the robot follows its commands, the nominal simulator does not", file=case.folder / "model.xml",
            found=f"{len(astray)} of {len(names)} joints: {', '.join(astray[:8])}",
            hint="fix the model first: servo gains in N m/rad (or per actuator's gear), force ranges, joint axes and "
            "ranges, what the robot collides with, and whether its base is held",
        )  # fmt: skip


# ---------------------------------------------------------------- likely mistakes


def _likely(names: tuple[str, ...], real: F64, model: F64, follows: Sequence[bool]) -> list[str]:
    """Correlations that a robot which follows its commands does not have."""
    good = np.isfinite(real).all(axis=1) & np.isfinite(model).all(axis=1)
    if good.sum() < 20:
        return []
    a, b = real[good] - real[good].mean(axis=0), model[good] - model[good].mean(axis=0)
    size_a, size_b = np.sqrt((a**2).mean(axis=0)), np.sqrt((b**2).mean(axis=0))
    corr = (a.T @ b) / len(a) / np.maximum(np.outer(size_a, size_b), 1e-12)
    found = []
    for j, name in enumerate(names):
        if size_b[j] < 1e-3 or size_a[j] < 1e-3:
            continue
        if follows[j]:
            if disagreement(real[:, j], model[:, j]) > WRONG:
                found.append(f"{name}: the robot follows the command, the nominal simulator does not: check model.xml")
            continue
        if corr[j, j] < -0.8:
            found.append(f"{name}: positions look negated")
        best = int(np.argmax(np.abs(corr[j])))
        if best != j and corr[j, best] > 0.97 and corr[j, j] < 0.6:
            found.append(f"{name}: its column looks like that of {names[best]}: check the order of joints")
    return found


def _torque_units(simulator: Simulator, nominal: list[F64]) -> list[str]:
    """Refuses torques that are a known unit's or the sign's factor away in every joint; warns where one joint is odd.

    A single joint of several proves no unit: what it carries may be many times what the model knows of.
    """
    torque, scales = _all(simulator.case, "joint_torque"), {}
    for c, channel in enumerate(simulator.channels):
        if channel.signal == "joint_torque":
            like = np.concatenate([y[:, c] for y in nominal])
            good = np.isfinite(torque[:, channel.index]) & np.isfinite(like)
            a, b = torque[good, channel.index], like[good]
            if min(a @ a, b @ b) >= 1e-12:  # (factor of least squares, cosine)
                scales[channel.label] = float(a @ b / (b @ b)), float(abs(a @ b) / np.sqrt((a @ a) * (b @ b)))
    factors = {unit: 1 / f for unit, f in TORQUE.items() if f != 1.0} | {"-1": -1.0}
    for unit, factor in factors.items():
        if scales and all(cosine > LIKE and 0.6 < scale / factor < 1.6 for scale, cosine in scales.values()):
            found = ", ".join(f"{name} {scale:.3g} times as large" for name, (scale, _) in scales.items())
            expected = "agreement with the nominal simulator, in N m and the contract's signs"
            raise _refusal(simulator.case, "joint_torque", "joint_torque", unit, expected, found)
    notes = []
    for name, (scale, cosine) in scales.items():
        if scale >= -0.25 and 0.25 <= abs(scale) <= 4:
            continue
        if cosine < LIKE:  # a unit is in question only where the courses agree
            if _of_its_servo(simulator.case, name, torque):  # what the ground gives to which leg no simulator foretells
                continue
            notes.append(
                f"{name}: the logged torque has another course than the nominal simulator's ({scale:.3g} times as "
                "large): check friction, damping and load of the joint in model.xml"
            )
        elif -4 < scale < -0.25:
            notes.append(f"{name}: torque looks negated")
        else:
            notes.append(f"{name}: torque is {scale:.3g} times the simulator's: is it in N m?")
    return notes


def _of_its_servo(case: Case, label: str, torque: F64) -> bool:
    """Whether a joint's torque has the course of a position servo's law on the logged command and motion, of its row
    and the one before: a drive's torque is older than its row."""
    j = case.joint_names.index(label)
    if (command := _commanded(case, label)) is None:
        return False
    now = [command, *(_all(case, signal)[:, j] for signal in ("joint_pos", "joint_vel") if case.has(signal))]
    rows = np.stack([torque[:, j], *now, *(np.roll(v, 1) for v in now)], axis=1)
    y, x = np.split(rows[np.isfinite(rows).all(axis=1)], [1], axis=1)
    gains = np.linalg.lstsq(x, y, rcond=None)[0]
    return bool(np.sum((x @ gains) ** 2) > LIKE**2 * np.sum(y**2) and gains[0] + gains[len(now)] > 0)


def _imu(simulator: Simulator, nominal: list[F64]) -> list[str]:
    """At rest an accelerometer reads +g upward in m/s^2; the first tenth of a second tells."""
    case = simulator.case
    columns = [i for i, c in enumerate(simulator.channels) if c.signal == "imu_acc"]
    if not columns:
        return []
    real = np.concatenate([r.signals["imu_acc"][r.time < 0.1] for r in case.runs])
    model = np.concatenate([y[r.time < 0.1][:, columns] for r, y in zip(case.runs, nominal, strict=True)])
    a, b = np.nanmedian(real, axis=0), np.nanmedian(model, axis=0)
    size = float(np.linalg.norm(a))
    expected = "specific force in m/s^2: +9.81 upward at rest"
    if (unit := gravity_unit(size)) not in ("", "m/s^2"):
        raise _refusal(case, "imu_acc", "imu_acc", unit, expected, f"{size:.2f} at rest")
    if size < 3:
        return [
            f"imu_acc is {size:.2g} m/s^2 at rest: gravity appears to have been removed; log the raw specific force"
        ]
    cosine = float(a @ b / (size * np.linalg.norm(b) + 1e-9))
    if cosine < -0.9:
        raise _refusal(case, "imu_acc", "imu_acc", "-1", expected, "gravity points the other way")
    if cosine < 0.8:
        return ["imu_acc: gravity points elsewhere than at imu_site in model.xml: check the site's frame"]
    return []


def _base(case: Case) -> list[str]:
    """Units of the base's position; order and length of its quaternion."""
    notes = []
    for run in case.runs:
        quat, place = run.signals.get("base_quat"), run.signals.get("base_pos")
        if place is not None and float(np.nanmedian(np.abs(place[:, 2]))) > 30:
            found = f"a height of {np.nanmedian(place[:, 2]):.3g} in {run.name}"
            hint = '"units": {"base_pos": "mm"} in log.json'
            raise GapError("base_pos looks like millimetres", file=case.folder, found=found, hint=hint)
        if quat is None or not case.floating:
            continue
        length = float(np.nanmedian(np.linalg.norm(quat, axis=1)))
        if abs(length - 1) > 0.02:
            notes.append(f"{run.name}: base_quat has length {length:.3g}; it is normalised")
        upright = np.array([1.0, 0, 0, 0]) if run.init_qpos is None else run.init_qpos[3:7]
        first = quat[np.isfinite(quat).all(axis=1)][:1]
        if len(first) and _tilt(first, upright) > 1.2 and _tilt(first[:, [3, 0, 1, 2]], upright) < 0.4:
            raise GapError(
                "base_quat looks like x y z w", file=case.folder, expected="w x y z",
                found=f"{np.round(first[0], 3).tolist()} at the start of {run.name}",
                hint="bring the columns into the order w x y z",
            )  # fmt: skip
    return notes


def _tilt(quat: F64, reference: F64) -> float:
    """Angle between the vertical axes of two orientations, rad."""
    turn = rotation_from(quat, reference)[0]
    angle = float(np.linalg.norm(turn))
    vertical = turn[2] / max(angle, 1e-9)
    return float(np.arccos(np.clip(np.cos(angle) + (1 - np.cos(angle)) * vertical**2, -1, 1)))


def _all(case: Case, signal: str) -> F64:
    return np.concatenate([r.signals[signal] for r in case.runs])
