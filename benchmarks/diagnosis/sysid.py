"""Baseline of the withheld check: `mujoco.sysid` with all parameters, beside the diagnosis, on the same cases.

    pip install 'mujoco[sysid]'
    python benchmarks/diagnosis/withheld.py ...                # first: cases, labels and diagnoses below --work
    python benchmarks/diagnosis/sysid.py --per-robot 4

Takes cases with one cause each from the work folder of `withheld.py`. For each, `mujoco.sysid` fits armature,
damping, dry friction, both gains of every joint, and mass, centre of mass and inertia of every link, all at once, on
the runs that the diagnosis fitted. Its answer to "what is the cause" is the parameter that moved most in units of its
everyday deviation (the sizes that the diagnosis itself takes as no gap). Both are then simulated on the runs that
neither saw.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.score import hit, top1
from benchmarks.store import Store
from realsim.gap import EFFECTS, Case, DiagnoseConfig, load_case
from realsim.gap.answer.check import mean_square
from realsim.gap.case.model.edit import Edit
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.sampling import held_mean
from realsim.gap.simulation.simulate import Simulator
from tests.truths.diagnosis.cases import read_labels

RESULTS = Path(__file__).parents[1] / "results" / "gap_sysid.json"
ROBOTS = ("pendulum", "arm2", "arm6")
BY_KIND = {
    "kp": "stiffness_gain",
    "kd": "damping_gain",
    "armature": "armature",
    "damping": "viscous_friction",
    "frictionloss": "coulomb_friction",
    "mass": "payload",
    "com": "com_offset",
    "inertia": "link_inertia",
}
"""Kind of parameter -> the effect that it stands for."""


@dataclass(frozen=True)
class Knob:
    """One parameter of the fit: its nominal value, its bounds, and what it may deviate by without being a gap."""

    kind: str
    place: str
    nominal: float
    low: float
    high: float
    unit: float

    @property
    def cause(self) -> dict[str, Any]:
        kind = self.kind.split()[0]
        where = "bodies" if kind in ("mass", "com", "inertia") else "joints"
        return {"effect": BY_KIND[kind], where: [self.place]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--per-robot", type=int, default=4)
    parser.add_argument("--robots", nargs="*", default=list(ROBOTS), choices=ROBOTS)
    parser.add_argument("--iterations", type=int, default=25, help="at most this many of mujoco.sysid's optimiser")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--work", type=Path, default=Path("out/gap_withheld"), help="that of withheld.py")
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):
        print("mujoco.sysid is not complete here: pip install 'mujoco[sysid]'", file=sys.stderr)
        return 1
    rows: list[dict[str, Any]] = []
    failed: list[dict[str, str]] = []
    for name, label in chosen(args.work, args.robots, args.per_robot).items():
        kept = args.work / "sysid" / f"{name}.json"
        if not kept.is_file():
            found = json.loads((args.work / "out" / name / "diagnosis.json").read_text())
            try:
                row = compare(args.work / "cases" / name, label, found, args)
            except ValueError as error:  # MuJoCo refuses the model that the optimiser tries
                failed.append({"case": name, "error": str(error).splitlines()[0]})
                print(f"{name}: mujoco.sysid fails: {failed[-1]['error']}", flush=True)
                continue
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text(json.dumps(row, indent=1) + "\n")
        rows.append({"case": name, **json.loads(kept.read_text())})
        print(line(rows[-1]), flush=True)
    if not rows:
        print(f"no diagnosed cases with one cause in {args.work}: run withheld.py first", file=sys.stderr)
        return 2
    store = Store(args.store, ("case",))
    store.rows = []
    store.facts = {"summary": summary(rows), "failed": failed}
    for row in rows:
        store.add(row)
    print(json.dumps(store.facts, indent=1))
    return 0


def chosen(work: Path, robots: list[str], per_robot: int) -> dict[str, dict[str, Any]]:
    """Name -> label: the first diagnosed cases with one cause of each robot."""
    single = {n: v for n, v in read_labels(work).items() if v["cls"] == "single"}
    done = {n: v for n, v in single.items() if (work / "out" / n / "diagnosis.json").is_file()}
    of = {r: [n for n in done if done[n]["robot"] == r][:per_robot] for r in robots}
    return {n: done[n] for r in robots for n in of[r]}


def compare(folder: Path, label: dict[str, Any], found: dict[str, Any], args: argparse.Namespace) -> dict[str, Any]:
    """What both say of one case, and the squared error that both leave on the unseen runs (1: the nominal one's)."""
    case = load_case(folder)
    config = DiagnoseConfig(threads=args.threads)
    names = [r.name for r in case.runs]
    fitted = [names.index(n) for n in found["statistics"]["fitted_runs"]]
    held = [names.index(n) for n in found["shrinkage"]["runs"]]
    began, cpu = time.perf_counter(), time.process_time()
    with Simulator(case, config) as simulator:
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, config)
        knobs, spec = fit_everything(simulator, fitted, args.iterations, args.threads)
        edit = Edit(simulator.context)
        edit._spec = spec
        raw = simulator.roll_out(edit, held)
        left = [comparison.residual(i, simulator.read(case.runs[i], r, edit)) for i, r in zip(held, raw, strict=True)]
    before = [comparison.residual(i, nominal[i]) for i in held]
    order = sorted(knobs, key=lambda k: -abs(k[1] - k[0].nominal) / k[0].unit)
    truth, says = label["effects"][0], order[0][0].cause
    first = next(iter(found["causes"]), None)
    return {
        "robot": label["robot"],
        "truth": {k: truth.get(k) for k in ("effect", "joints", "bodies")},
        "in_its_set": truth["effect"] in BY_KIND.values(),
        "sysid": {
            "says": says,
            "top1": hit(says, truth),
            "top1_with_equivalents": hit(says, truth) or any(hit(says, t) for e in label["equivalents"] for t in e),
            "beyond_three_units": sum(abs(v - k.nominal) > 3 * k.unit for k, v in knobs),
            "parameters": len(knobs),
            "after": ratio(mean_square(comparison, left, held), mean_square(comparison, before, held)),
            "seconds": round(time.perf_counter() - began, 1),
            "cpu_seconds": round(time.process_time() - cpu, 1),
        },
        "realsim": {
            "verdict": found["verdict"],
            "says": first and {k: first.get(k) for k in ("effect", "joints", "bodies")},
            "top1": top1(label, found) == 2,
            "top1_with_equivalents": top1(label, found) >= 1,
            "after": float(found["shrinkage"]["after"]),
            "seconds": found["seconds"],
            "cpu_seconds": found["cpu_seconds"],
        },
    }


def ratio(after: float, before: float) -> float | None:
    return after / before if np.isfinite(after) else None


# ---------------------------------------------------------------- the fit


def fit_everything(
    simulator: Simulator, runs: list[int], iterations: int, threads: int
) -> tuple[list[tuple[Knob, float]], Any]:
    """((knob, fitted value) of all knobs, the fitted MjSpec with the simulator's sensors)."""
    from mujoco import sysid

    knobs = all_knobs(simulator)
    params = sysid.ParameterDict()
    for k in knobs:  # in units of the everyday deviation, 0 is the nominal model: that conditions the problem well
        bounds = (k.low - k.nominal) / k.unit, (k.high - k.nominal) / k.unit
        params.add(sysid.Parameter(f"{k.kind} {k.place}", 0.0, *bounds, modifier=_modifier(simulator.case, k)))
    residual = sysid.build_residual_fn(models_sequences=[_sequence(simulator, i) for i in runs], n_threads=threads)
    best, _ = sysid.optimize(params, residual, optimizer="mujoco", verbose=False, max_iters=iterations, eps=1e-2)
    spec = sysid.apply_param_modifiers_spec(best, simulator.context.spec.copy())
    return [(k, k.nominal + k.unit * float(best[f"{k.kind} {k.place}"].value[0])) for k in knobs], spec


def all_knobs(simulator: Simulator) -> list[Knob]:
    """Every parameter per joint and per link that the fit may move; units are the diagnosis's own everyday sizes."""
    context, model = simulator.context, simulator.case.model
    found = []
    for joint in context.driven:
        actuator = model.actuator(context.actuator[joint])
        kp, kd = float(actuator.gainprm[0]), float(-actuator.biasprm[2])
        armature, inertia = context.armature(joint), context.inertia[joint]
        dry, viscous = context.friction(joint), context.damping(joint)
        slope = context.torque_scale(joint) / context.speed_scale(joint)
        found += [
            Knob("kp", joint, kp, 0.15 * kp, 3 * kp, kp * _everyday(simulator, "stiffness_gain", joint)),
            Knob("kd", joint, kd, 0.15 * kd, 5 * kd, kd * _everyday(simulator, "damping_gain", joint)),
            Knob("armature", joint, armature, 0.1 * armature, armature + 5 * inertia,
                 max(_everyday(simulator, "armature", joint), 0.005 * inertia)),
            Knob("damping", joint, viscous, 0.0, viscous + slope, _everyday(simulator, "viscous_friction", joint)),
            Knob("frictionloss", joint, dry, 0.0, dry + context.torque_scale(joint),
                 _everyday(simulator, "coulomb_friction", joint)),
        ]  # fmt: skip
    for name in context.bodies:
        mass = float(model.body(name).mass[0])
        found.append(Knob("mass", name, mass, 0.3 * mass, 4 * mass, _everyday(simulator, "payload", name)))
        shift = _everyday(simulator, "com_offset", name)
        found += [Knob(f"com {axis}", name, 0.0, -0.1, 0.1, shift) for axis in "xyz"]
        found.append(Knob("inertia", name, 1.0, 0.2, 5.0, _everyday(simulator, "link_inertia", name)))
    return found


def _everyday(simulator: Simulator, effect: str, place: str) -> float:
    return float(EFFECTS[effect].parameters(simulator.context, (place,))[0].nuisance)


def _modifier(case: Case, knob: Knob) -> Callable[[Any, Any], None]:
    """Writes one parameter into a spec, as `mujoco.sysid` wants it."""
    from mujoco import sysid

    def write(spec: Any, parameter: Any) -> None:
        value = knob.nominal + knob.unit * float(parameter.value[0])
        if knob.kind in ("kp", "kd"):
            apply = sysid.apply_pgain if knob.kind == "kp" else sysid.apply_dgain
            apply(spec, case.actuator_of(knob.place), value)
        elif knob.kind == "damping":
            joint = spec.joint(knob.place)
            damping = np.array(joint.damping)  # a polynomial's coefficients; the first is the linear one
            damping.flat[0] = value
            joint.damping = damping
        elif knob.kind in ("armature", "frictionloss"):
            setattr(spec.joint(knob.place), knob.kind, value)
        else:
            body = spec.body(knob.place)
            if not body.explicitinertial:
                nominal = case.model.body(knob.place)
                body.mass, body.inertia, body.ipos, body.iquat = (
                    float(nominal.mass[0]), nominal.inertia, nominal.ipos, nominal.iquat,
                )  # fmt: skip
                body.explicitinertial = True
            if knob.kind == "mass":
                body.mass = value
            elif knob.kind == "inertia":
                body.inertia = body.inertia * value
            else:
                body.ipos = body.ipos + value * np.eye(3)["xyz".index(knob.kind[-1])]

    return write


def _sequence(simulator: Simulator, index: int) -> Any:
    """One run as `mujoco.sysid` takes it: settled on the first command before it, as in the diagnosis."""
    from mujoco import sysid

    case, settle = simulator.case, simulator.config.settle_seconds
    run, spec = case.runs[index], case.spec.copy()
    for sensor in list(spec.sensors):
        spec.delete(sensor)  # measured columns are looked up by their place among the model's sensors
    kind, obj, columns = mujoco.mjtSensor, mujoco.mjtObj, []
    for signal, sensor in (("joint_pos", kind.mjSENS_JOINTPOS), ("joint_vel", kind.mjSENS_JOINTVEL)):
        if signal in run.signals:
            columns.append(run.signals[signal])
            for joint in case.joint_names:
                spec.add_sensor(name=f"{signal} {joint}", type=sensor, objtype=obj.mjOBJ_JOINT, objname=joint)
    if case.torque_kind == "measured" and "joint_torque" in run.signals:
        columns.append(run.signals["joint_torque"])
        for joint in case.joint_names:
            spec.add_sensor(
                name=f"torque {joint}", type=kind.mjSENS_ACTUATORFRC, objtype=obj.mjOBJ_ACTUATOR,
                objname=case.actuator_of(joint),
            )  # fmt: skip
    model = spec.compile()
    steps = int(np.ceil((run.duration + settle) / model.opt.timestep)) + 2
    grid = np.arange(steps + 1) * model.opt.timestep
    command = np.zeros((steps, model.nu))
    mean = held_mean(run.time + settle, run.command, grid)
    for u, name in enumerate(case.actuator_names):
        command[:, model.actuator(name).id] = mean[:, u]
    data = mujoco.MjData(model)
    for j, joint in enumerate(case.joint_names):
        data.qpos[model.joint(joint).qposadr[0]] = np.nanmedian(run.signals["joint_pos"][:5, j])
    values = np.concatenate(columns, axis=1)
    whole = np.isfinite(values).all(axis=1)
    return sysid.ModelSequences(
        run.name,
        spec,
        run.name,
        sysid.create_initial_state(model, data.qpos, data.qvel, data.act),
        # A hair short, so that resampling to the time step does not round up to one step more.
        sysid.TimeSeries.from_control_names(grid[:-1] * (1 - 1e-9), command, model),
        sysid.TimeSeries.from_names(run.time[whole] + settle, values[whole], model),
    )


# ---------------------------------------------------------------- what came of it


def line(row: dict[str, Any]) -> str:
    truth, theirs, ours = row["truth"], row["sysid"], row["realsim"]
    left = "failed" if theirs["after"] is None else f"{theirs['after']:.3f}"
    return (
        f"{row['case']}: {truth['effect']} {_at(truth)} | sysid: {theirs['says']['effect']} {_at(theirs['says'])}, "
        f"left {left}, {theirs['seconds']:.0f} s | realsim: {ours['verdict']}, "
        f"{ours['says']['effect'] + ' ' + _at(ours['says']) if ours['says'] else 'nothing'}, "
        f"left {ours['after']:.3f}, {ours['seconds']:.0f} s"
    )


def _at(cause: dict[str, Any]) -> str:
    return ", ".join([*(cause.get("joints") or []), *(cause.get("bodies") or [])])


def summary(rows: list[dict[str, Any]], peer: str = "sysid") -> dict[str, Any]:
    """Shares as [hits, of] and medians of the error left on unseen runs, of a peer and of realsim."""
    inside = [r for r in rows if r["in_its_set"]]
    out: dict[str, Any] = {}
    for who in (peer, "realsim"):
        left = [r[who]["after"] for r in rows if r[who]["after"] is not None]
        out[who] = {
            "top1": [sum(r[who]["top1"] for r in rows), len(rows)],
            "top1_with_equivalents": [sum(r[who]["top1_with_equivalents"] for r in rows), len(rows)],
            "top1_where_the_peer_has_the_cause": [sum(r[who]["top1"] for r in inside), len(inside)],
            "left_on_unseen_runs_median": float(np.median(left)) if left else None,
            "worse_than_nominal_on_unseen_runs": [sum(v > 1 for v in left), len(left)],
            "cpu_seconds_median": float(np.median([r[who]["cpu_seconds"] for r in rows])),
        }
    moved = [r[peer]["beyond_three_units"] for r in rows]
    out[peer]["parameters_moved_beyond_three_units_median"] = float(np.median(moved))
    return out


if __name__ == "__main__":
    raise SystemExit(main())
