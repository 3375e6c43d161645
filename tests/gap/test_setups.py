"""Runs with a known mass or another known gain are pooled with the others."""

import json
from pathlib import Path

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.case.split import replicates
from realsim.gap.simulation.simulate import Simulator

from .truth import Truth


def changed(made, tmp_path: Path, runs: dict) -> Path:
    import shutil

    folder = tmp_path / "case"
    shutil.copytree(made(Truth()), folder)
    log = json.loads((folder / "log.json").read_text())
    (folder / "log.json").write_text(json.dumps(log | {"runs": runs}))
    return folder


def test_a_known_mass_and_gain_do_what_the_effects_do(made, tmp_path: Path) -> None:
    plain = load_case(made(Truth()))
    first, second, *others = [r.name for r in plain.runs]
    gain = -float(plain.model.actuator(plain.actuator_of("elbow")).biasprm[1])
    at = [0.0, 0.0, -0.2]
    said = {
        first: {"payload": [{"body": "fore", "mass": 0.4, "at": at}]},
        second: {"gains": {plain.actuator_of("elbow"): {"kp": 0.5 * gain}}},
    }
    with Simulator(plain, DiagnoseConfig(threads=1)) as nominal:
        base = nominal.simulate()
        heavy = nominal.simulate([("payload", ("fore",), {"mass": 0.4, **dict(zip("xyz", at, strict=True))})])
        soft = nominal.simulate([("stiffness_gain", ("elbow",), {"ratio": np.log(0.5)})])
    case = load_case(changed(made, tmp_path, said))
    with Simulator(case, DiagnoseConfig(threads=1)) as pooled:
        found = pooled.simulate()
        twice = pooled.simulate([("stiffness_gain", ("elbow",), {"ratio": np.log(2.0)})])
    assert np.abs(heavy[0] - base[0]).max() > 1e-3
    np.testing.assert_allclose(found[0], heavy[0], atol=1e-6)
    np.testing.assert_allclose(found[1], soft[1], atol=1e-6)
    for ours, theirs in zip(found[2:], base[2:], strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
    np.testing.assert_allclose(twice[1], base[1], atol=1e-6)  # an effect's ratio counts on top of the known gain
    assert others
    assert not any(0 in group for group in replicates(case))


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        ({"nowhere": {}}, "no run"),
        ({"run_00": {"payload": [{"body": "hand", "mass": 1, "at": [0, 0, 0]}]}}, "not in model.xml"),
        ({"run_00": {"payload": [{"body": "fore", "mass": 1}]}}, "cannot be read"),
        ({"run_00": {"mass": 1}}, "cannot be read"),
        ({"run_00": {"payload": [{"body": "fore", "mass": float("nan"), "at": [0, 0, 0]}]}}, "cannot be read"),
        ({"run_00": {"payload": [{"body": "fore", "mass": 1, "at": [0, 0, -300]}]}}, "cannot be read"),
        ({"run_00": {"payload": [{"body": "fore", "mass": 1e-320, "at": [0, 0, 0]}]}}, "cannot be read"),
        ({"run_00": {"gains": {"elbow_servo": {"kp": float("inf")}}}}, "cannot be read"),
        ([1], "cannot be read"),
    ],
)
def test_what_is_not_there_is_refused(made, tmp_path: Path, runs, said: str) -> None:
    with pytest.raises(GapError, match=said):
        load_case(changed(made, tmp_path, runs))
