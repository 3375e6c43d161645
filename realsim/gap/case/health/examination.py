"""Is this log fit for a diagnosis? Refused with the reason where it is not; otherwise figures and warnings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.gap.case.case import Case, Run
from realsim.gap.case.health.conventions import log_conventions, nominal_conventions
from realsim.gap.case.health.signals import (
    beyond_range,
    clocks,
    initial_states,
    missing,
    noise,
    quanta,
    saturation,
    spikes,
)
from realsim.gap.case.model.channels import uncompared
from realsim.gap.case.model.edit import Edit
from realsim.gap.case.split import replicates
from realsim.gap.inference.evidence.inverse import torque_residual
from realsim.gap.simulation.simulate import Simulator
from realsim.gap.simulation.state import initial_state

UNDRIVEN = 0.5
"""Share of a torque's variance that may have nothing to do with the motion."""
OTHER_UNIT = 30.0
"""Times its logged torque that a joint's motion may lack: a share of the largest torque of a strong drive, or kN m, is
farther off. Not tuned: the joint that lacks least lacks 0.24 times at most in 18 generated logs, 4.2 in ten of a real
pendulum that its torque hardly foretells."""
OVERLAP = 0.005
"""m that bodies of a robot may be inside each other: meshes' hulls touch at a joint by some millimetres."""
RUNAWAY = 100.0
"""rad/s or m/s that no joint of a robot reaches."""
IMPACT = 0.05
"""Seconds that a joint may be so fast in a simulator after an impact. Not tuned: none of 50 logs is refused by it."""
SOME_FALLS = 1 / 3
"""Share of the runs in which the nominal simulator may fall over before the log is refused."""


def examine(simulator: Simulator) -> dict[str, Any]:
    """Figures and `warnings`. Raises GapError where no diagnosis is possible."""
    case = simulator.case
    warnings = list(case.warnings) + [f"left out: {d}" for d in case.dropped_runs]
    clock, notes = clocks(case)
    warnings += notes
    warnings += log_conventions(case)
    warnings += _overlaps(simulator)
    warnings += _failures(simulator)
    warnings += _excitation(case)
    gone, notes = missing(case)
    warnings += notes + spikes(case) + uncompared(case) + beyond_range(case)
    nominal = simulator.simulate()
    warnings += nominal_conventions(simulator, nominal)
    start, notes = initial_states(simulator)
    warnings += notes
    full, notes = saturation(simulator)
    warnings += notes
    floor, notes = noise(simulator, nominal)
    warnings += _undriven(simulator)
    return {
        "clock": clock,
        "missing": gone,
        "quantum": quanta(case),
        "noise": floor,
        "start": start,
        "saturation": full,
        "warnings": gathered(warnings + notes, [r.name for r in case.runs]),
    }


def _undriven(simulator: Simulator) -> list[str]:
    """Torques that are not those of the motion beside them."""
    found = torque_residual(simulator)
    if found is None:
        return []
    case, needed = simulator.case, np.sqrt(found.share)
    if (needed > OTHER_UNIT).all():
        raise GapError(
            "the logged torque cannot drive the logged motion",
            file=case.folder,
            expected="torques in N m, of the same joints at the same time as the motion",
            found=f"{found.joints[0]} lacks {needed[0]:.3g} times its logged torque (rms)",
            hint="a share of the largest torque (-1 to 1) must be multiplied by it; or look which columns are torques",
        )
    return [
        f"{joint}: the logged torque cannot drive the logged motion ({share:.0%} of its variance is not what that asks "
        "for, friction included): is it this joint's, in this order, of the same instant, and not filtered?"
        for joint, share in zip(found.joints, found.undriven, strict=True)
        if share > UNDRIVEN
    ]


def gathered(warnings: Sequence[str], runs: Sequence[str]) -> list[str]:
    """Warnings with the same text about several runs as one: `run_01, run_02 and 5 more: ...`."""
    about: dict[str, list[str]] = {}
    for warning in warnings:
        name, colon, text = warning.partition(": ")
        known = colon and Path(name).stem in runs
        about.setdefault(text if known else warning, []).extend([Path(name).stem] if known else [])
    found = []
    for text, names in about.items():
        more = f" and {len(names) - 3} more" if len(names) > 4 else ""
        listed = ", ".join(names[: 3 if more else 4])
        found.append(f"{listed}{more}: {text}" if names else text)
    return found


def _excitation(case: Case) -> list[str]:
    still = sum(bool((np.ptp(r.command, axis=0) < 1e-6).all() and r.enabled is None) for r in case.runs)
    if still == len(case.runs):
        raise GapError(
            "no run excites the robot: all commands are constant",
            file=case.folder,
            expected="commands that move the joints",
            hint="record slow and fast motion with reversals",
        )
    moved = np.max([np.ptp(r.command, axis=0) for r in case.runs], axis=0)
    idle = [name for name, m in zip(case.actuator_names, moved, strict=True) if m < 1e-6]
    who = "1 run holds" if still == 1 else f"{still} runs hold"
    notes = [f"{who} one command: loads at rest are all that shows"] if still else []
    if any(len(group) == len(case.runs) for group in replicates(case)):
        notes.append("all runs repeat one command: no run is left to check the diagnosis on; record other motion too")
    if idle:
        notes.append(f"never commanded to move, so the log says little about them: {', '.join(idle)}")
    return notes


def _failure(case: Case, run: str, track: dict[str, Any], row: int, joint: int | None) -> GapError:
    """What went wrong before the first row without numbers: no numbers at once, or ever more speed of a joint."""
    settle, dt = track["settle"]
    if joint is not None:
        row = int(np.argmax(np.abs(track["vel"][:, joint]) > RUNAWAY))
    when = row * dt - settle
    where = f"in {run} at {when:.2f} s" if when >= 0 else f"while it settles before {run} begins"
    if joint is not None:
        torque = case.command_kind == "torque"
        unit = 'if commands are not in N m, say so in log.json: "units": {"command": "N cm"}; ' if torque else ""
        return GapError(
            "the nominal simulator runs away",
            file=case.folder / "model.xml",
            found=f"{case.joint_names[joint]} turns faster than {RUNAWAY:g} rad/s {where}",
            hint=f"{unit}give the joint its range, friction and damping; or shorten the runs (--max-seconds): a robot "
            "that was kept upright by feedback falls when its torques are only replayed",
        )
    return GapError(
        "the nominal simulator explodes",
        file=case.folder / "model.xml",
        found=where,
        hint="check gains, inertias and the time step of model.xml before looking for a gap",
    )


def _runaway(run: Run, track: dict[str, Any], rows: int) -> int | None:
    """The joint that is faster than any robot's for longer than an impact, where the logged one is not on the whole."""
    fast = (np.abs(track["vel"][:rows]) > RUNAWAY).sum(axis=0) * track["settle"][1]
    way = np.nansum(np.abs(np.diff(run.signals["joint_pos"], axis=0)), axis=0)
    fast = np.where(way > RUNAWAY * run.duration, 0.0, fast)
    return int(np.argmax(fast)) if fast.max(initial=0.0) > IMPACT else None


def _overlaps(simulator: Simulator) -> list[str]:
    """Refuse a model whose own bodies are inside each other where the robot's runs begin.

    MuJoCo does not let parent and child collide, unless the parent is fixed to the world: a trunk that is held in the
    air pushes its own hips away. What begins inside the ground is a warning, not an error: ground that is lower than
    in the model may be the gap.
    """
    import mujoco

    case = simulator.case
    model, data = case.model, mujoco.MjData(case.model)
    found: dict[tuple[str, str], float] = {}
    notes = []
    for run, start in zip(case.runs, simulator.starts, strict=True):
        sunk = 0.0
        state = initial_state(case, model, run, Edit(simulator.context), start)
        mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            bodies = [int(model.geom_bodyid[g]) for g in contact.geom]
            if 0 in bodies or _terrain(case, bodies):
                sunk = max(sunk, float(-contact.dist))
            elif contact.dist < -OVERLAP:
                a, b = sorted(model.body(i).name or f"body {i}" for i in bodies)
                found[a, b] = max(found.get((a, b), 0.0), float(-contact.dist))
        if sunk > OVERLAP:
            notes.append(
                f"{run.name}: the robot begins {1000 * sunk:.0f} mm inside the ground, which pushes it out: is the "
                "base's height that of this model, and does the model's ground lie where the robot's does?"
            )
    if found:
        worst = sorted(found.items(), key=lambda item: -item[1])[:6]
        raise GapError(
            "bodies of the robot are inside each other where the runs begin",
            file=case.folder / "model.xml",
            expected=f"no contact deeper than {1000 * OVERLAP:g} mm between its own bodies",
            found="; ".join(f"{a} and {b}: {1000 * depth:.0f} mm" for (a, b), depth in worst),
            hint="exclude these pairs with <contact><exclude body1=... body2=.../></contact> (MuJoCo lets a body that "
            "is fixed to the world collide with its children), or turn contacts off: "
            '<option><flag contact="disable"/></option>',
        )
    return notes


def _terrain(case: Case, bodies: Sequence[int]) -> bool:
    """Whether one of the two is what a floating robot stands on."""
    return case.floating and any(case.model.body_weldid[b] == 0 for b in bodies)


def _failures(simulator: Simulator) -> list[str]:
    """The nominal simulator must survive the runs: say where and when it does not.

    A few falls refuse no log: such a run is compared up to where robot and simulator part for good.
    """
    case, falls = simulator.case, []
    for run, begun, track in zip(case.runs, simulator.starts, simulator.nominal_tracks, strict=True):
        settle, dt = track["settle"]
        bad = ~np.isfinite(track["pos"]).all(axis=1)
        rows = int(np.argmax(bad)) if bad.any() else bad.size
        joint = _runaway(run, track, rows)
        if bad.any() or joint is not None:
            raise _failure(case, run.name, track, rows, joint)
        if "base_pos" in track and "base_pos" in run.signals and not begun.anchors:
            real = run.signals["base_pos"][:, 2]
            low = float(np.nanmin(track["base_pos"][:, 2]))
            start = float(np.nanmedian(real[:5]))
            if low < 0.5 * start <= np.nanmin(real) * 1.4:
                falls.append((run.name, float(np.argmax(track["base_pos"][:, 2] < 0.5 * start)) * dt - settle))
    notes = ", ".join(f"in {name} at {when:.2f} s" for name, when in falls)
    if len(falls) > SOME_FALLS * len(case.runs):
        raise GapError(
            "the nominal simulator falls over where the robot does not",
            file=case.folder / "model.xml",
            found=notes,
            hint="shorten the runs (max_seconds), or fix the model first: do gains and force ranges bear the robot?",
        )
    return [f"the nominal simulator falls over where the robot does not, {notes}"] if falls else []
