"""Public bug reports whose cause is in the robot, not in the policy's contract: rebuilt from what they say.

    python benchmarks/diagnosis/reports.py --jobs 2 --store benchmarks/results/gap_reports.json

Small made robots (tests/gap/truth.py, with everyday deviations) that differ from their model as the report says; where
it names no size, the size stands here. The other nine of the eighteen reports are in contract.py.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.pool import Job
from benchmarks.diagnosis.put_in import answer_all, options
from benchmarks.store import Store
from tests.gap.truth import ARM, Truth, make_case
from tests.truths.written import write_case

WHEEL = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="wheel">
      <joint name="wheel" axis="0 1 0" damping="0.05" armature="0.02"/>
      <inertial pos="0 0 0" mass="1.5" diaginertia="0.004 0.008 0.004"/>
    </body>
  </worldbody>
  <actuator><velocity name="drive" joint="wheel" kv="2" forcelimited="true" forcerange="-8 8"/></actuator>
</mujoco>"""
BARE = ARM
for value in ("0.5", "0.25"):
    BARE = BARE.replace(f'frictionloss="{value}"', 'frictionloss="0"')
for value in ("0.3", "0.12"):
    BARE = BARE.replace(f'damping="{value}"', 'damping="0"')
LIGHT = ARM.replace('armature="0.08"', 'armature="0"').replace('armature="0.03"', 'armature="0"')
BOTH = ("shoulder", "elbow")


def both(first: float, second: float) -> dict[str, float]:
    return dict(zip(BOTH, (first, second), strict=True))


@dataclass(frozen=True)
class Report:
    """What a tracker says, as a robot beside its model."""

    says: str
    truth: Truth
    effects: Sequence[str]
    """What is to be named; nothing: the log is to be refused, with `refusal` in the message."""
    model: str = ARM
    alike: Sequence[str] = ()
    """Effects that change the motion as the first one does."""
    refusal: str = ""


REPORTS = {
    "lerobot 930": Report("a joint's calibration has the other sign", Truth(), (), refusal="elbow looks negated"),
    "SO-ARM100 149": Report("zeros of another calibration", Truth(offset=both(-0.06, 0.13)), ("joint_offset",)),
    "holosoma 47": Report("effort limit 50 in the model, 35 in the URDF", Truth(limit={"elbow": 4.2}),
                          ("torque_limit",), ARM.replace('-24 24', '-6 6')),
    "rl_sar 58": Report("stiffness 25 trained, 20 deployed", Truth(kp=both(0.8, 0.8)), ("stiffness_gain",)),
    "robot_lab 51": Report("motors answer 20 ms late", Truth(delay=0.02), ("command_delay",),
                           alike=("observation_delay",)),
    "walk-these-ways 41": Report("no rotor inertia in the model", Truth(armature=both(0.08, 0.03)), ("armature",),
                                 LIGHT),
    "learning-compliance 4": Report("no friction in the model", Truth(coulomb=both(1.0, 0.6), viscous=both(0.8, 0.4)),
                                    ("coulomb_friction", "viscous_friction"), BARE),
    "ros2_control_demos 551": Report("wheels answer velocity commands a second late", Truth(), ("command_delay",),
                                     WHEEL, ("observation_delay",)),
}  # fmt: skip
"""Repository and number -> report."""


def make(folder: Path, report: Report, seed: int) -> Path:
    """The case of a report, written to a folder."""
    if report.model == WHEEL:
        return make_wheel(folder, seed)
    make_case(folder, report.model, report.truth, seed=seed)
    if report.refusal:
        for path in (folder / "runs").glob("*.npz"):
            with np.load(path) as data:
                turned = {k: v * [1, -1] if k in ("joint_pos", "joint_vel") else v for k, v in data.items()}
            np.savez(path, **turned)
    return folder


def make_wheel(folder: Path, seed: int) -> Path:
    """Steps and waves of velocity, carried out a second late."""
    model, rng = mujoco.MjModel.from_xml_string(WHEEL), np.random.default_rng(seed)
    time, runs = 0.01 * np.arange(600), {}
    for number in range(5):
        steps = np.repeat(rng.uniform(-4, 4, 10), 60)
        waves = 3 * np.sin(2 * np.pi * rng.uniform(0.2, 0.6) * time + rng.uniform(0, 6))
        command = (steps if number % 2 else waves) * (time > 0.5)
        late = np.concatenate([np.zeros(100), command[:-100]])
        data, pos, vel = mujoco.MjData(model), [], []
        for value in late:
            pos.append(data.qpos[0])
            vel.append(data.qvel[0])
            data.ctrl[0] = value
            mujoco.mj_step(model, data, 5)
        runs[f"run_{number}"] = {
            "time": time,
            "command": command[:, None],
            "joint_pos": (pos + rng.normal(0, 3e-4, 600))[:, None],
            "joint_vel": (vel + rng.normal(0, 0.02, 600))[:, None],
        }
    return write_case(folder, WHEEL, runs, command_kind="velocity")


def judged(report: Report, row: dict[str, Any]) -> str:
    """`right`, `half` (some of it, or more beside it), `wrong` (something else under a verdict that names it), or
    `open`."""
    if report.refusal:
        return "right" if row["verdict"] == "refused" and report.refusal in row["said"] else "wrong"
    kinds = [{short.split("@")[0] for short in causes} for causes in (row["causes"], *row["equivalent"])]
    wanted = [set(report.effects), *({other, *report.effects[1:]} for other in report.alike)]
    if row["verdict"] not in ("identified", "ambiguous", "partly_explained"):
        return "open"
    if any(k in wanted for k in kinds):
        return "right"
    return "half" if any(k & w for k in kinds for w in wanted) else "wrong"


def label_of(name: str) -> dict[str, Any]:
    """The label of a report as `scored` takes it."""
    report = REPORTS[name]
    effects = [{"effect": e, "joints": None, "bodies": None} for e in report.effects]
    alike = [[effects[0] | {"effect": other} for other in report.alike]] * bool(effects) + [[]] * (len(effects) - 1)
    return {"effects": effects, "alike": alike, "visibility": [], "cls": "report", "visible": True, "log": name,
            "part": "reports"}  # fmt: skip


def main() -> None:
    parser = options(__doc__, "out/gap_reports")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    jobs = {}
    for name in args.only or REPORTS:
        folder = args.work / f"seed_{args.seed}" / name.replace(" ", "_")
        case = folder / "case" if (folder / "case").is_dir() else make(folder / "case", REPORTS[name], args.seed)
        jobs[name] = Job(case, folder / "answer", seconds=300)

    def kept(name: str, row: dict[str, Any]) -> dict[str, Any]:
        return row | {"judged": judged(REPORTS[name], row), "seed": args.seed, "says": REPORTS[name].says}

    store = Store(args.store or args.work / "rows.json", ("case", "seed"))
    answer_all(args, jobs, {n: label_of(n) for n in jobs}, store, kept)


if __name__ == "__main__":
    main()
