"""A user's own sizes of everyday deviations take the place of the library's, in the unit that is reported."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from realsim.core.errors import RealsimError
from realsim.gap import DiagnoseConfig, diagnose, load_case
from realsim.gap.effects import EFFECTS
from realsim.gap.provenance import provenance
from realsim.gap.simulation.simulate import Simulator

from .searching import logged
from .truth import FINE, Truth


def config(folder: Path, sizes: object) -> DiagnoseConfig:
    path = folder / "deviations.json"
    path.write_text(json.dumps(sizes))
    return DiagnoseConfig(threads=1, deviations=path, effects=("stiffness_gain", "coulomb_friction"), bootstrap=20)


@pytest.fixture(scope="module")
def folder(made: Callable[..., Path]) -> Path:
    return made(Truth(coulomb={"shoulder": 0.7}), runs=3, span=(2.2, 2.6))


def test_sizes_are_in_the_reported_unit_and_by_place(folder: Path, tmp_path: Path) -> None:
    sizes = {"stiffness_gain": {"ratio": 0.05}, "coulomb_friction": {"friction": {"elbow": 0.3}}}
    with Simulator(load_case(folder), config(tmp_path, sizes)) as simulator:
        context = simulator.context
        (gain,) = EFFECTS["stiffness_gain"].parameters(context, ("elbow",))
        assert gain.nuisance == pytest.approx(0.05, rel=1e-3)
        (mine,) = EFFECTS["coulomb_friction"].parameters(context, ("elbow",))
        (theirs,) = EFFECTS["coulomb_friction"].parameters(context, ("shoulder",))
        assert mine.nuisance == pytest.approx(0.3)
        assert theirs.nuisance < 0.3


@pytest.mark.parametrize(("steps", "named"), [(0.1, set()), (2.0, {"joint_compliance"})])
def test_any_joint_gives_a_little(steps: float, named: set[str], made: Callable[..., Path]) -> None:
    case = load_case(made(Truth(), FINE, runs=3))
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        (p,) = EFFECTS["joint_compliance"].parameters(simulator.context, ("shoulder",))
    soft = logged(case, [("joint_compliance", ("shoulder",), {"stiffness": steps * p.step})])
    effects = ("joint_compliance", "coulomb_friction", "stiffness_gain")
    found = diagnose(soft, DiagnoseConfig(threads=1, effects=effects, bootstrap=20))
    assert {c["effect"] for c in found.causes} == named


def test_a_compliance_has_the_size_of_the_stiffness_that_gives_it(folder: Path, tmp_path: Path) -> None:
    def size(stiffness: float) -> float:
        sizes = {"joint_compliance": {"stiffness": stiffness}}
        with Simulator(load_case(folder), config(tmp_path, sizes)) as simulator:
            (p,) = EFFECTS["joint_compliance"].parameters(simulator.context, ("elbow",))
            return p.nuisance

    assert size(8000.0) == pytest.approx(1 / 8000)
    assert size(0) == 0


def test_what_is_everyday_for_this_user_is_no_gap(folder: Path, tmp_path: Path) -> None:
    usual = diagnose(load_case(folder), config(tmp_path, {}))
    assert usual.causes
    wide = diagnose(load_case(folder), config(tmp_path, {"coulomb_friction": {"friction": 1.0}}))
    assert wide.verdict == "no_gap"


def test_an_answer_says_which_sizes_it_rests_on(tmp_path: Path) -> None:
    sizes = {"stiffness_gain": {"ratio": 0.05}}
    assert provenance(config(tmp_path, sizes))["settings"]["deviations"] == sizes
    assert provenance(DiagnoseConfig())["settings"]["deviations"] == {}


@pytest.mark.parametrize(
    ("sizes", "said"),
    [
        ([1], "not a file of deviations"),
        ({"stifness_gain": {"ratio": 0.1}}, "stiffness_gain"),
        ({"stiffness_gain": 0.1}, "no sizes"),
        ({"stiffness_gain": {"ratio": -0.1}}, "no standard deviation"),
        ({"stiffness_gain": {"ratio": True}}, "no standard deviation"),
        ({"stiffness_gain": {"ratio": float("nan")}}, "JSON|no standard deviation"),
        ({"stiffness_gain": {"factor": 0.1}}, "no parameter 'factor'"),
        ({"stiffness_gain": {"ratio": {"wrist": 0.1}}}, "no place 'wrist'"),
    ],
)
def test_a_wrong_file_is_refused_with_what_is_expected(folder: Path, tmp_path: Path, sizes: object, said: str) -> None:
    with pytest.raises(RealsimError, match=said), Simulator(load_case(folder), config(tmp_path, sizes)):
        pass
