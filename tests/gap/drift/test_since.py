"""What changed between two logs of one robot: found where it was injected, nothing said where nothing was."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim.cli.command_line import main
from realsim.core.errors import GapError
from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.drift.pair import BEFORE, pair_of
from realsim.gap.drift.since import changed_since, phrase
from realsim.gap.simulation.simulate import Simulator

from ..truth import PENDULUM, Truth, make_case

SETTINGS = DiagnoseConfig(
    threads=1, effects=("coulomb_friction", "viscous_friction", "stiffness_gain", "payload", "command_delay")
)
LOADED = Truth(viscous={"swing": 0.4})
"""What the robot has at both times."""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """`logs(name, truth, seed)`: robots of one seed share their everyday deviations; runs differ by `cut`."""
    root = tmp_path_factory.mktemp("drift")

    def make(name: str, truth: Truth) -> Path:
        folder = root / name
        if not folder.exists():
            make_case(folder, PENDULUM, truth, seed=5, runs=3, span=(2.8, 3.2))
        return folder

    return make


WORN = replace(LOADED, coulomb={"swing": 0.5})


def test_a_change_is_found_beside_what_stays(logs: Callable[..., Path]) -> None:
    found = changed_since(load_case(logs("wear", WORN)), load_case(logs("before", LOADED)), SETTINGS)
    named = {c["effect"]: c for c in (*found.changes, *(c for s in found.equivalent for c in s))}
    assert found.verdict in ("identified", "ambiguous"), found
    p = named["coulomb_friction"]["parameters"]["friction"]
    low, high = p["ci90"]
    assert low <= 0.5 <= high
    assert p["change"] == pytest.approx(0.5, rel=0.3)
    assert json.loads(json.dumps(found.as_dict()))["verdict"] == found.verdict


def test_nothing_changed(logs: Callable[..., Path]) -> None:
    """The same robot on other commands and with other noise."""
    folder = logs("before", LOADED)
    case = load_case(folder)
    noisy = []
    rng = np.random.default_rng(1)
    for run in case.runs[::-1]:
        read = {k: v + rng.normal(0, 1e-4, v.shape) for k, v in run.signals.items()}
        noisy.append(replace(run, signals=read))
    found = changed_since(case.with_runs(tuple(noisy)), case, SETTINGS)
    assert found.verdict == "unchanged", found
    assert found.changes == ()
    assert "Nothing changed" in found.sentence


def test_the_command_says_it_on_the_page_and_in_the_json(
    logs: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    worn, before = logs("wear", WORN), logs("before", LOADED)
    out = tmp_path / "diagnosis"
    few = ["--effects", "coulomb_friction", "viscous_friction", "payload", "--threads", "1", "--json"]
    assert main(["diagnose", str(worn), "--since", str(before), "--out", str(out), *few]) == 0
    said = json.loads(capsys.readouterr().out)["since"]
    assert said["case"] == "before"
    assert said["verdict"] in ("identified", "ambiguous")
    assert "What changed since before" in (out / "report.html").read_text()


def test_both_logs_are_in_the_pair(logs: Callable[..., Path]) -> None:
    case = load_case(logs("before", LOADED))
    pair = pair_of(case, case, SETTINGS)
    names = [r.name for r in pair.case.runs]
    assert [names[i] for i in pair.before] == [f"{BEFORE}{names[i]}" for i in pair.now]
    assert pair.notes == ()


def test_a_change_acts_in_the_later_log_alone_on_top_of_what_both_share(logs: Callable[..., Path]) -> None:
    case = load_case(logs("before", LOADED))
    pair, place = pair_of(case, case, SETTINGS), ("swing",)
    with Simulator(pair.case, SETTINGS) as simulator:
        simulator.begin_from([("viscous_friction", place, {"damping": 0.4})])
        shared = simulator.simulate()
        found = simulator.simulate([("viscous_friction since", place, {"damping": 0.2})])
    with Simulator(pair.case, SETTINGS) as simulator:
        more = simulator.simulate([("viscous_friction", place, {"damping": 0.6})])
    for then in pair.before:
        np.testing.assert_array_equal(found[then], shared[then])
    for now in pair.now:
        np.testing.assert_allclose(found[now], more[now], atol=1e-9)
        assert np.abs(found[now] - shared[now]).max() > 1e-3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"joint_names": ("knee",)}, "another robot"),
        ({"actuator_names": ("a", "b")}, "another robot"),
        ({"command_kind": "torque"}, "command_kind"),
        ({"base": "floating"}, "base"),
    ],
)
def test_another_robot_is_refused(logs: Callable[..., Path], change: dict, said: str) -> None:
    case = load_case(logs("before", LOADED))
    with pytest.raises(GapError, match=said):
        pair_of(case, replace(case, **change), SETTINGS)


def test_another_robot_leaves_no_output(logs: Callable[..., Path], tmp_path: Path) -> None:
    other = make_case(tmp_path / "other", PENDULUM.replace("swing", "knee"), Truth(), runs=2, span=(2.0, 2.2))
    out = tmp_path / "diagnosis"
    assert main(["diagnose", str(logs("before", LOADED)), "--since", str(other), "--out", str(out)]) == 2
    assert not out.exists()


def test_signals_that_only_one_log_has_are_left_out(logs: Callable[..., Path]) -> None:
    case = load_case(logs("before", LOADED))
    pair = pair_of(replace(case, torque_kind="measured", xml=case.xml + "<!-- -->"), case, SETTINGS)
    assert pair.case.torque_kind == "none"
    assert any("torque" in note for note in pair.notes)
    assert any("models" in note for note in pair.notes)


def test_words() -> None:
    grown = {"before": 0.5, "now": 0.8, "change": 0.3, "unit": "N m", "ci90": [0.2, 0.4]}
    change = {"effect": "coulomb_friction", "joints": ["elbow"], "parameters": {"friction": grown}}
    assert phrase(change) == "elbow: Coulomb friction grew by 0.3 N m [0.2, 0.4], from 0.5 to 0.8"
    fallen = grown | {"before": 0.8, "now": 0.5, "change": -0.3, "ci90": [-0.4, -0.2]}
    assert "fell by 0.3 N m [0.2, 0.4]" in phrase(change | {"parameters": {"friction": fallen}})
    ratio = {"before": 1.0, "now": 0.7, "change": 0.7, "unit": "ratio", "ci90": [0.6, 0.8]}
    weak = {"effect": "motor_gain", "joints": ["elbow"], "parameters": {"ratio": ratio}}
    assert phrase(weak) == "elbow: motor gain is 0.7 times [0.6, 0.8] what it was"
    limit = {"before": None, "now": 4.0, "change": None, "unit": "N m/rad", "ci90": None, "now_ci90": [3.0, 5.0]}
    soft = {"effect": "joint_compliance", "joints": ["elbow"], "parameters": {"stiffness": limit}}
    assert phrase(soft).endswith("is now 4 N m/rad [3, 5]")
    place = {a: {"before": None, "now": v, "change": None, "unit": "m", "ci90": None, "now_ci90": [v, v]}
             for a, v in (("x", 0.0), ("y", 0.0), ("z", -0.2))}  # fmt: skip
    mass = {"before": 0.0, "now": 0.3, "change": 0.3, "unit": "kg", "ci90": [0.2, 0.4]}
    tool = {"effect": "payload", "bodies": ["hand"], "parameters": {"mass": mass, **place}}
    assert phrase(tool) == "hand: payload grew by 0.3 kg [0.2, 0.4], from 0 to 0.3 at (0, 0, −0.2) m"
