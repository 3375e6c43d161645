"""Logs of real robots are read, examined and localised without a false refusal; spoiled, they are refused."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import Case, DiagnoseConfig, diagnose, load_case
from realsim.gap.case.health import examine
from realsim.gap.inference.evidence.where import evidence, localise
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator

from .real_logs import legs, pendulum, servo

CONFIG = DiagnoseConfig(threads=1)


def looked_at(case: Case) -> tuple[dict[str, Any], list[Any], dict[str, Any]]:
    """(health, where, evidence) as the diagnosis begins with them."""
    with Simulator(case, CONFIG) as simulator:
        health = examine(simulator)
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, CONFIG)
        residuals = [comparison.residual(i, y) for i, y in enumerate(nominal)]
        entries, _ = localise(comparison, residuals, range(len(nominal)), simulator.nominal_tracks)
        return health, entries, evidence(simulator, comparison, residuals)


def rows(found: dict[str, Any], signal: str = "joint_pos") -> list[float]:
    return [v for k, v in found["error_by_horizon"][signal].items() if k != "whole run"]


def test_pendulum_driven_by_its_torque(shared: Callable[[str], Path], tmp_path: Path) -> None:
    case = load_case(pendulum(shared("real_logs"), tmp_path / "case", ["ddp", "dircol"]))
    health, where, more = looked_at(case)
    assert health["quantum"]["joint_pos"] == pytest.approx(2.9e-3, rel=0.02)  # the encoder's step, behind the gear
    assert health["noise"]["joint_pos"]["sample"] < 2e-3
    assert where[0]["joint"] == "swing"
    errors = rows(more)
    assert errors == sorted(errors)
    assert errors[0] < 5e-3 < errors[-1]
    # The documented friction of the gear is some tenths of a newton metre, and the model has none.
    assert 0.2 < more["torque_residual"]["swing"]["rms_Nm"] < 1.0


@pytest.mark.slow
def test_swing_ups_with_feedback_are_diagnosed_from_states_of_the_log(
    shared: Callable[[str], Path], tmp_path: Path
) -> None:
    """Replayed as a whole they end 10 rad off. Documented: Coulomb friction 0.18 N m, viscous 0.047 N m s/rad."""
    case = load_case(
        pendulum(shared("real_logs"), tmp_path / "case", ["energy_shaping_nominal", "sac", "pd_1nm_limit"])
    )
    rivals = ("coulomb_friction", "viscous_friction", "payload")
    found = diagnose(case, replace(CONFIG, effects=rivals, bootstrap=50))
    assert found.causes[0]["effect"] == "coulomb_friction"
    assert found.causes[0]["parameters"]["friction"]["value"] == pytest.approx(0.2, abs=0.05)
    assert found.shrinkage["fraction"] > 0.9
    assert any("it goes on from states of the log" in w for w in found.health["warnings"])


def test_pendulum_whose_bus_is_slower_than_its_log(shared: Callable[[str], Path], tmp_path: Path) -> None:
    health, _, _ = looked_at(load_case(pendulum(shared("real_logs"), tmp_path / "case", ["pd_1nm_limit"])))
    assert any("the bus is slower than the log" in w for w in health["warnings"])
    assert any("late samples" in w for w in health["warnings"])
    assert any("only one run" in w for w in health["warnings"])


@pytest.mark.parametrize(("scale", "said"), [(180 / np.pi, "deg/s"), (-1.0, "negated"), (30 / np.pi, "rpm")])
def test_velocities_in_other_units_are_told_on_real_data(
    shared: Callable[[str], Path], tmp_path: Path, scale: float, said: str
) -> None:
    case = load_case(pendulum(shared("real_logs"), tmp_path / "case", ["ddp", "dircol"]))
    runs = [replace(r, signals=r.signals | {"joint_vel": scale * r.signals["joint_vel"]}) for r in case.runs]
    with pytest.raises(GapError, match=said):
        looked_at(case.with_runs(tuple(runs)))


def test_servo_as_csv(shared: Callable[[str], Path], tmp_path: Path) -> None:
    case = load_case(servo(shared("real_logs"), tmp_path / "case"))
    assert [r.name for r in case.runs] == [
        "kp32_lift_and_drop", "kp32_sin_sin", "kp32_sin_time_square", "kp32_up_and_down",
    ]  # fmt: skip
    health, _, more = looked_at(case)
    assert health["quantum"]["joint_pos"] == pytest.approx(2 * np.pi / 4096, rel=1e-3)
    assert health["clock"]["median_step_s"] == pytest.approx(1 / 47, rel=0.1)
    assert not any("does not begin at rest" in w for w in health["warnings"])
    assert list(more["error_by_horizon"]["joint_pos"]) == ["one sample", "100 ms", "500 ms", "whole run"]


def test_legs_of_a_quadruped(shared: Callable[[str], Path], tmp_path: Path) -> None:
    case = load_case(legs(shared("real_logs"), tmp_path / "case"))
    health, where, more = looked_at(case)
    assert any("generated, not measured" in w for w in health["warnings"])  # its source says so: a linspace
    assert {e["joint"] for e in where} <= set(case.joint_names)
    assert np.isfinite(rows(more)).all()


def test_hips_that_begin_inside_a_held_trunk_are_refused(shared: Callable[[str], Path], tmp_path: Path) -> None:
    with pytest.raises(GapError, match="inside each other") as caught:
        looked_at(load_case(legs(shared("real_logs"), tmp_path / "case", contacts=True)))
    assert "base" in str(caught.value)
    assert "exclude body1" in str(caught.value)


def test_a_torque_that_is_not_the_joint_s_cannot_drive_it(shared: Callable[[str], Path], tmp_path: Path) -> None:
    case = load_case(pendulum(shared("real_logs"), tmp_path / "case", ["ddp", "dircol"]))
    health, _, _ = looked_at(case)
    assert not any("cannot drive" in w for w in health["warnings"])
    turned = [replace(r, signals=r.signals | {"joint_torque": r.signals["joint_torque"][::-1]}) for r in case.runs]
    health, _, _ = looked_at(case.with_runs(tuple(turned)))
    assert any("swing: the logged torque cannot drive the logged motion" in w for w in health["warnings"])


def test_legs_in_degrees_are_refused(shared: Callable[[str], Path], tmp_path: Path) -> None:
    case = load_case(legs(shared("real_logs"), tmp_path / "case"))
    runs = [replace(r, signals={"joint_pos": np.degrees(r.signals["joint_pos"])}) for r in case.runs]
    with pytest.raises(GapError, match="looks like deg"):
        looked_at(case.with_runs(tuple(runs)))
