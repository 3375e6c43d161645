"""Does the recording that `realsim excite` asks for decide?

    python benchmarks/diagnosis/next.py --seed 27 --cases 20 --minutes 60

Draws robots of one or two joints with one cause each (`tests.truths.diagnosis`), whose operator recorded little (one
slow run, one livelier one, no torque), and diagnoses them. Where that is ambiguous, the experiment that the tool asks
for is simulated on the true robot (not on a rival), added, and diagnosed again; beside it one excitation of the
library at random, of the same length and within the same limits. A case counts where the verdict then is `identified`
and names the true cause alone.

Causes that no recording of these signals can tell from others are not drawn: late commands and late readings without
an IMU, and a shifted centre of mass on one link. There a point mass m at r has the moment and the inertia of a mass M
shifted from l to l + d, if m r = M d and r = 2 l + d. An ambiguous case for which the tool asks for nothing counts as
one that is not decided. Rows are stored by seed, case and engine; an interrupted run goes on.
"""

import argparse
import copy
import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.score import hit, same, short
from benchmarks.store import Store
from realsim.core.errors import RealsimError
from realsim.core.files import to_json, write_text
from realsim.gap import DiagnoseConfig, diagnose, load_case
from realsim.gap.config import ExciteConfig
from realsim.gap.experiments.choose import look
from realsim.gap.experiments.excitations import EXCITATIONS
from realsim.gap.experiments.plan import Experiment, Planned
from realsim.gap.experiments.proposal import bench_of
from realsim.gap.experiments.rivals import rivals_from
from realsim.gap.experiments.write import setups
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.provenance import engine
from realsim.gap.simulation.simulate import Simulator
from tests.truths.diagnosis import cases, causes
from tests.truths.diagnosis.motions import motion, sample_times
from tests.truths.diagnosis.plant import Plant
from tests.truths.diagnosis.robots import ROBOTS, Robot
from tests.truths.diagnosis.truth import Truth

RESULTS = Path(__file__).parents[1] / "results" / "gap_next.json"
EFFECTS = (
    "payload", "damping_gain", "motor_gain", "com_offset", "coulomb_friction", "viscous_friction", "joint_compliance",
    "stiffness_gain",
)  # fmt: skip
"""Causes that others can imitate in a short log."""
IMITATED = {("pendulum", "com_offset")}
"""(robot, cause) that another cause imitates in every log."""
RECORDED, SECONDS = ("slow", "sines"), 5.0
"""Motions of the first log, one run each; a last run repeats the first."""


class Real:
    """The true robot, set up as an experiment wants it."""

    def __init__(self, robot: Robot, truth: Truth, sensors: cases.Sensors, seed: int) -> None:
        self.robot, self.truth, self.sensors = robot, truth, sensors
        self.rng = np.random.default_rng([seed, 5])

    def record(self, run: Planned) -> dict[str, np.ndarray] | None:
        """The log of one run; None if the robot does not stay upright or finite."""
        truth, robot = _set_up(self.robot, self.truth, run)
        plant = Switched(robot, truth, run.time, run.enabled)
        times = run.time + self.rng.uniform(-0.0005, 0.0005, len(run.time))
        trace = plant.drive(times, run.command)
        if not trace.upright:
            return None
        arrays = cases._record(robot, self.sensors, truth, times, run.command, trace, self.rng)
        if run.enabled is not None:
            arrays["enabled"] = np.asarray(run.enabled, np.uint8)
        return arrays


class Switched(Plant):
    """The true robot with drives that are switched off now and then; the switch comes as late as a command."""

    def __init__(self, robot: Robot, truth: Truth, time: np.ndarray, enabled: Any) -> None:
        super().__init__(robot, truth)
        self._when, self._enabled = time, enabled

    def _servo(self, now: float, command: np.ndarray) -> np.ndarray:
        delivered = super()._servo(now, command)
        if self._enabled is None:
            return delivered
        row = max(int(np.searchsorted(self._when, now - self.truth.command_delay + 1e-9, side="right")) - 1, 0)
        return np.where(self._enabled[row], delivered, 0.0)


def _set_up(robot: Robot, truth: Truth, run: Planned) -> tuple[Truth, Robot]:
    """The truth with the gains of a run in proportion, the robot with its mass."""
    changed = copy.deepcopy(truth)
    nominal = mujoco.MjModel.from_xml_string(robot.xml)
    for actuator, which, value in run.setup.gains:
        j = robot.actuators.index(actuator)
        column = 1 if which == "kp" else 2
        ratio = value / -float(nominal.actuator(actuator).biasprm[column])
        (changed.kp if which == "kp" else changed.kd)[j] *= ratio
    if not run.setup.payload:
        return changed, robot
    spec = mujoco.MjSpec.from_string(robot.xml)
    for body, mass, at in run.setup.payload:
        load = spec.body(body).add_body(name=f"{body}__known", pos=at)
        load.mass, load.inertia, load.explicitinertial = mass, np.full(3, 1e-6), True
        load.ipos = np.zeros(3)
    spec.compile()
    return changed, replace(robot, xml=spec.to_xml())


def draw(seed: int, index: int, folder: Path) -> tuple[Real, list[dict[str, Any]]] | None:
    """(the true robot, its label); the case is written to `folder`. None where the cause leaves no trace."""
    kind = ("pendulum", "arm2")[index % 2]
    effects = [e for e in EFFECTS if (kind, e) not in IMITATED]
    effect = effects[index // 2 % len(effects)]
    for attempt in range(6):
        rng = np.random.default_rng([seed, index, attempt])
        robot = ROBOTS[kind](rng)
        sensors = replace(cases._sensors(robot, "single", rng), torque_kind="none", torque_constant=1.0)
        site = cases.site_of(robot, mujoco.MjModel.from_xml_string(robot.xml), seed * 1000 + index)
        truth = Truth(len(robot.joints))
        cases._nuisances(truth, site, rng)
        usual = copy.deepcopy(truth)
        label = causes.available(robot)[effect](truth, site, rng, float(rng.uniform(0.7, 1.0)))
        commands = []
        for move in RECORDED:
            times = sample_times(rng, sensors.rate, SECONDS)
            commands.append((times, motion(robot, rng, times, move)))
        again = sample_times(rng, sensors.rate, SECONDS)
        commands.append((again, commands[0][1]))
        traces = cases._drive(robot, truth, commands)
        if traces is None:
            continue
        if min(cases.visibility(robot, sensors, [usual, truth], commands[:2])) < cases.VISIBLE:
            continue
        cases.write_log(folder, robot, sensors, truth, commands, traces, rng)
        return Real(robot, truth, sensors, seed * 1000 + index), [label]
    return None


def decided(folder: Path, real: Real, experiment: Experiment, label: list[dict[str, Any]]) -> dict[str, Any]:
    """What the diagnosis says once the experiment was recorded on the true robot."""
    with tempfile.TemporaryDirectory() as work:
        plan = Path(work)
        write_text(plan / "experiment.json", to_json({"runs": setups(experiment)}))
        (plan / "recorded").mkdir()
        for run in experiment.runs:
            arrays = real.record(run)
            if arrays is None:
                return {"verdict": "the robot fails", "right": False, "causes": []}
            np.savez_compressed(plan / "recorded" / f"{run.name}.npz", allow_pickle=False, **arrays)
        try:
            found = diagnose(load_case(folder, [plan]), SETTINGS).as_dict()
        except RealsimError as error:
            return {"verdict": "refused", "right": False, "causes": [], "said": error.message}
    return said(found, label)


def said(found: dict[str, Any], label: list[dict[str, Any]]) -> dict[str, Any]:
    """Verdict and causes in short, and whether they are the truth alone."""
    sets = [[short(c) for c in s] for s in (found["causes"], *found["equivalent"])]
    right = found["verdict"] == "identified" and same(found["causes"], label)
    named = any(any(hit(c, t) for c in s) for t in label for s in (found["causes"], *found["equivalent"]))
    return {"verdict": found["verdict"], "right": right, "named": named, "causes": sets}


def one_case(seed: int, index: int) -> dict[str, Any]:
    """A row."""
    row: dict[str, Any] = {"seed": seed, "case": index, "engine": engine()}
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work) / "case"
        began = time.process_time()
        drawn = draw(seed, index, folder)
        if drawn is None:
            return row | {"verdict": "not drawn"}
        real, label = drawn
        row |= {"robot": real.robot.name, "truth": [short(t) for t in label]}
        try:
            case = load_case(folder)
            found = diagnose(case, SETTINGS).as_dict()
        except RealsimError as error:
            return row | {"verdict": "refused", "said": error.message}
        first = said(found, label)
        row |= {"verdict": first["verdict"], "right": first["right"], "named": first["named"], "sets": first["causes"]}
        row["cpu_seconds"] = round(time.process_time() - began, 1)
        if found["verdict"] != "ambiguous":
            return row
        with Simulator(case, SETTINGS) as simulator:
            comparison = Comparison(case, simulator.channels, simulator.simulate(), SETTINGS)
            rivals = rivals_from(found["next_experiment"]["rivals"], simulator.context)
            bench = bench_of(simulator.context, comparison.noise, ExciteConfig(), SETTINGS)
            asked = found["next_experiment"]
            name, best = asked["excitation"], asked["looked_at"][0]
            experiment = EXCITATIONS[name](bench.rig, best["size"]) if name else None
            # At random, at its largest size within the limits: what one would record unasked.
            order = np.random.default_rng(seed * 1000 + index).permutation(list(EXCITATIONS))
            looked = (look(bench, rivals, [str(name)], finalists=0)[0].predicted for name in order)
            other = next((p.experiment for p in looked if p is not None), None)
        row["asked"] = {
            "excitation": name,
            "posterior": asked["expected_posterior"],
            "log_bayes_factor": asked["expected_log_bayes_factor"],
            "decides": asked["decides"],
        }
        if experiment is not None:
            row["asked"] |= decided(folder, real, experiment, label)
        if other is not None:
            row["random"] = {"excitation": other.name, **decided(folder, real, other, label)}
    row["cpu_seconds"] = round(time.process_time() - began, 1)
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """All ambiguous rows, and the sums."""
    ambiguous = [r for r in rows if r["verdict"] == "ambiguous"]
    lines = [f"{len(rows)} cases drawn, {len(ambiguous)} ambiguous"]
    for r in ambiguous:
        asked, other = r.get("asked", {}), r.get("random", {})
        expects = f"p {asked.get('posterior')} log BF {asked.get('log_bayes_factor')}"
        lines.append(f"{r['seed']}/{r['case']:<3} {r['robot']:8} {','.join(r['truth']):30} {r['sets']}")
        lines.append(f"      asked  {asked.get('excitation')!s:15} {expects} -> {_outcome(asked)}")
        lines.append(f"      random {other.get('excitation')!s:15} -> {_outcome(other)}")

    def count(of: list[dict[str, Any]], key: str) -> str:
        return f"{sum(bool(r.get(key, {}).get('right')) for r in of)}/{len(of)}"

    asked_for = [r for r in ambiguous if r.get("asked", {}).get("excitation")]
    sure = [r for r in asked_for if r["asked"].get("decides")]
    for key in ("asked", "random"):
        lines.append(
            f"right alone after the {key} excitation: {count(ambiguous, key)} of all ambiguous cases, "
            f"{count(asked_for, key)} where one was requested, {count(sure, key)} where it was to decide"
        )
    return "\n".join(lines)


def _outcome(found: dict[str, Any]) -> str:
    if "verdict" not in found:
        return "nothing asked"
    return f"{found['verdict']} {found.get('causes', '')} {'RIGHT' if found.get('right') else ''}"


SETTINGS = DiagnoseConfig(threads=1, report=False)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=27)
    parser.add_argument("--cases", type=int, default=20, help="ambiguous cases at which to stop")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--store", type=Path, default=RESULTS)
    parser.add_argument("--show", action="store_true", help="print what is stored")
    args = parser.parse_args()
    store = Store(args.store, ("seed", "case", "engine"))
    began, index = time.monotonic(), args.first

    def mine() -> list[dict[str, Any]]:
        return [r for r in store.rows if r["seed"] == args.seed and r["engine"] == engine()]

    while not args.show and time.monotonic() - began < 60 * args.minutes:
        if sum(r["verdict"] == "ambiguous" for r in mine()) >= args.cases:
            break
        if not any(r["case"] == index for r in mine()):
            print(json.dumps(store.add(one_case(args.seed, index)), default=float), flush=True)
        index += 1
    print(table(mine()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
