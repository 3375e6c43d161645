"""Every law does what the truth generator does: with the true values, the simulator shows what the robot showed."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from realsim.gap import EFFECTS, DiagnoseConfig, load_case
from realsim.gap.effects.base import Parameter
from realsim.gap.simulation.simulate import Setting, Simulator, measured
from tests.truths.diagnosis import causes
from tests.truths.diagnosis.exact import write_exact
from tests.truths.diagnosis.robots import ROBOTS
from tests.truths.diagnosis.truth import Truth

CONFIG = DiagnoseConfig(threads=1, settle_seconds=0.3)
LEFT = {"contact_compliance": 0.2, "ground_friction": 0.4}
"""Share of the squared error that may stay, beside what stays without any cause, where a foot slips; else 0.05."""
MOTION = ("joint_pos", "base_pos", "base_rot", "imu_gyro")
"""Signals that are held against each other; torque and acceleration depend on when in a step they are read."""
SOLVER: list[Setting] = [("contact_solver", (), {"cone": 1.0, "creep": float(np.log(2 / 5))})]
"""The generator's contacts: the other friction cone, and impratio 2 instead of 5."""
NAMES = {f"{prefix}{a}": a for prefix in ("pos_", "d") for a in "xyz"}
"""Names in the contract's output whose coordinates are called otherwise."""


def causes_of(robot: str) -> list[str]:
    return sorted(causes.available(ROBOTS[robot](np.random.default_rng(0))))


def test_masses_of_a_single_hinge_are_one_cause() -> None:
    def one(robot: str, *effects: str) -> bool:
        made = ROBOTS[robot](np.random.default_rng(0))
        site = causes.Site(made, mujoco.MjModel.from_xml_string(made.xml), np.ones(1), np.ones(1))
        return causes.one_by_physics([{"effect": e} for e in effects], site)

    assert one("pendulum", "payload", "com_offset")
    assert not one("pendulum", "payload", "coulomb_friction")
    assert not one("pendulum", "payload")
    assert not one("arm2", "payload", "com_offset")


@pytest.fixture(scope="module")
def without(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, float]]:
    """Mean squared error of a simulator whose robot has no cause, by robot and signal."""
    return {r: errors(tmp_path_factory.mktemp(r) / "case", r, None)[0] for r in ("arm2", "quadruped")}


@pytest.mark.parametrize("effect", causes_of("arm2"))
def test_on_an_arm(effect: str, without: dict[str, dict[str, float]], tmp_path: Path) -> None:
    assert share_left(without["arm2"], *errors(tmp_path / "case", "arm2", effect)) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("effect", sorted({*causes.GROUND_CAUSES, *causes.IMU_CAUSES}))
def test_on_the_ground(effect: str, without: dict[str, dict[str, float]], tmp_path: Path) -> None:
    assert share_left(without["quadruped"], *errors(tmp_path / "case", "quadruped", effect)) < LEFT.get(effect, 0.05)


def share_left(without: dict[str, float], before: dict[str, float], after: dict[str, float]) -> float:
    """The largest of the signals that a cause changes much."""
    gaps = {s: before[s] / without[s] for s in before}
    return max((after[s] - without[s]) / before[s] for s in before if gaps[s] > 0.1 * max(gaps.values()))


def errors(folder: Path, robot: str, effect: str | None) -> tuple[dict[str, float], dict[str, float]]:
    """Mean squared error by signal of the nominal simulator, and of the one with the true values."""
    label, truth = write_exact(folder, robot, effect)
    case = load_case(folder)
    with Simulator(case, CONFIG) as simulator:
        logged = np.concatenate([measured(run, simulator.channels) for run in case.runs])
        solver = SOLVER if simulator.context.touches else []
        nominal = np.concatenate(simulator.simulate(solver))
        cause = settings_of(simulator, label, truth) if label else []
        changed = np.concatenate(simulator.simulate([*solver, *cause]))
        signals = np.array([c.signal for c in simulator.channels])
    shown = [s for s in MOTION if s in signals]
    both = [{s: float(np.nanmean((y - logged)[:, signals == s] ** 2)) for s in shown} for y in (nominal, changed)]
    return both[0], both[1]


def settings_of(simulator: Simulator, label: dict[str, Any], truth: Truth) -> list[Setting]:
    effect = EFFECTS[label["effect"]]
    values = {NAMES.get(q["name"], q["name"]): q["value"] for q in label["parameters"]}
    found: list[Setting] = []
    for place in [(name,) for name in label["joints"] or label["bodies"] or []] or [()]:
        known = {p.name: p for p in effect.parameters(simulator.context, place)}
        named = {n: coordinate(known[n], v) for n, v in values.items() if n in known}
        if effect.name == "external_force":  # the label holds no times
            _, named["start"], named["end"] = truth.force[place[0]]
        if effect.name == "terrain_wobble":
            named["relaxation"] = truth.wobble[place[0]][1] / truth.wobble[place[0]][0]
        found.append((effect.name, place, named))
    return found


def coordinate(p: Parameter, value: float) -> float:
    """The reverse of `report`."""
    low, high = p.bounds
    grid = np.linspace(low, high, 401)[1:]
    start = int(np.argmin([abs(p.report(z) - value) for z in grid]))
    near = grid[max(start - 1, 0)], grid[min(start + 1, len(grid) - 1)]
    return float(minimize_scalar(lambda z: abs(p.report(z) - value), bounds=near, method="bounded").x)
