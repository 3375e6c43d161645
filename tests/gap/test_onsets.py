"""A push that comes at a moment of its own in each run."""

import pytest

from realsim.gap import DiagnoseConfig, diagnose, load_case
from realsim.gap.inference.evidence.onsets import find_onsets
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator

from .truth import Truth

PUSHED = {"run_02": 1.9, "run_03": 1.2, "run_05": 2.3, "run_06": 2.3}
SPAN = (3.0, 3.3)
"""Seconds of a run: the last push ends at 2.8."""
RIVALS = ("external_force", "coulomb_friction", "payload", "command_delay")


def windows(pushed: dict[str, float]) -> tuple[tuple[float, float] | None, ...]:
    return tuple((at, at + 0.5) if (at := pushed.get(f"run_{i:02d}")) else None for i in range(1, 7))


def onsets_of(folder) -> dict[str, float]:
    case, config = load_case(folder), DiagnoseConfig(threads=1)
    with Simulator(case, config) as simulator:
        nominal = simulator.simulate()
        return find_onsets(Comparison(case, simulator.channels, nominal, config), nominal)


@pytest.fixture(scope="module")
def bumped(made):
    return made(Truth(force={"fore": (14.0, 0.0, 6.0)}, force_windows=windows(PUSHED)), runs=6, span=SPAN)


def test_onsets_are_read_off_the_log(bumped) -> None:
    found = onsets_of(bumped)
    assert set(found) == set(PUSHED)
    assert all(abs(found[name] - at) < 0.1 for name, at in PUSHED.items())


@pytest.mark.parametrize(
    "truth",
    [
        Truth(),
        Truth(coulomb={"elbow": 3.0}),
        Truth(force={"fore": (14.0, 0.0, 6.0)}, force_window=(1.0, 1.5)),
    ],
)
def test_other_gaps_have_none(made, truth: Truth) -> None:
    """A lasting cause is there from the first motion on; a force at a fixed time has that time."""
    assert onsets_of(made(truth, runs=4, span=SPAN)) == {}


@pytest.mark.slow
def test_a_push_beside_a_lasting_cause_is_found_once_that_is_known(made) -> None:
    pushed = windows({"run_02": 1.9, "run_03": 1.2, "run_04": 2.3})
    truth = Truth(force={"fore": (18.0, 0.0, 8.0)}, force_windows=pushed, coulomb={"shoulder": 3.0})
    folder = made(truth, runs=4, span=SPAN)
    assert onsets_of(folder) == {}
    both = ("coulomb_friction", "external_force")
    found = diagnose(load_case(folder), DiagnoseConfig(effects=both, bootstrap=50, max_causes=2))
    assert {c["effect"] for c in found.causes} == set(both)


@pytest.mark.slow
def test_the_push_is_found_and_checked_on_a_run_that_no_fit_saw(bumped) -> None:
    found = diagnose(load_case(bumped), DiagnoseConfig(effects=RIVALS))
    assert found.verdict in ("identified", "ambiguous")
    (cause,) = found.causes
    assert (cause["effect"], cause["bodies"]) == ("external_force", ["fore"])
    assert cause["parameters"]["fx"]["value"] == pytest.approx(14.0, rel=0.15)
    assert cause["parameters"]["lasts"]["value"] == pytest.approx(0.5, abs=0.08)
    assert found.shrinkage["runs"] == ["run_06"]
    assert found.shrinkage["kind"] == "validation"
    assert any("was read off them (run_06 at 2." in w for w in found.health["warnings"])
    assert found.shrinkage["fraction"] > 0.8
    assert found.sentence.startswith("Your model lacks external force of ")
    (force,) = found.patch["wrappers"]["external_force"]["value"]
    assert force["since_onset"]
    assert set(found.patch["wrappers"]["external_force"]["onsets_s"]) == set(PUSHED)
