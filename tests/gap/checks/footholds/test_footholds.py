"""Footholds: what a stake was changed by is found, and nothing is named where nothing was changed."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.stats import norm

import realsim as rs
from realsim.cli.command_line import main
from realsim.core.errors import GapError, RealsimError
from realsim.gap.case.case import load_case
from realsim.gap.checks.camera.mixed import fit
from realsim.gap.checks.camera.terrain import CELL, load_terrain
from realsim.gap.checks.footholds.run import check_scene
from realsim.gap.checks.footholds.touches import Part, clearance
from tests.truths.crossings import Truth, make_case

XML = """<mujoco><worldbody><geom name="ground" type="plane" size="1 1 .1"/>
<geom name="step" type="box" pos=".3 0 .05" size=".1 .5 .05"/>
<geom name="ghost" type="box" pos="0 0 .3" size=".1 .1 .01" contype="0" conaffinity="0"/>
<body name="ball" pos="0 0 .2"><freejoint/><geom name="ball" size=".02"/></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def lowered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four short crossings with a stake that is 2 cm lower than in scene.xml."""
    folder = tmp_path_factory.mktemp("lowered")
    make_case(folder, Truth(height={"stake_L3": -0.02}), crossings=4, terrain_seed=7, seed=7, cycles=2)
    return folder


def test_a_stake_lowered_by_2_cm_is_found_to_5_mm(lowered: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "out"
    assert (
        main(["footholds", str(lowered / "case"), "--scene", str(lowered / "scene.xml"), "--out", str(out), "--json"])
        == 0
    )
    said = json.loads(capsys.readouterr().out)
    assert said["changed"] == ["stake_L3"]
    assert said["verdict"]["level"] == "look"
    hold = next(h for h in said["footholds"] if h["name"] == "stake_L3")
    assert hold["changes"] == ["height"]
    assert hold["height"]["value"] == pytest.approx(-0.02, abs=0.005)
    assert hold["height"]["ci90"][0] < -0.018 < hold["height"]["ci90"][1] + 0.003
    assert (out / "report.html").stat().st_size > 10_000
    before, after = (mujoco.MjModel.from_xml_path(str(f)) for f in (lowered / "scene.xml", out / "scene.xml"))
    moved = after.geom("stake_L3").pos - before.geom("stake_L3").pos
    assert moved == pytest.approx([0, 0, hold["height"]["value"]], abs=1e-6)


def test_nothing_is_named_where_nothing_was_changed(tmp_path: Path) -> None:
    case = make_case(tmp_path, Truth(), crossings=3, terrain_seed=8, seed=8, cycles=2)
    found = rs.footholds(str(case), tmp_path / "scene.xml")
    assert found["changed"] == []
    assert found["verdict"]["level"] == "good"


def test_a_log_in_another_frame_is_refused(lowered: Path) -> None:
    case = load_case(lowered / "case")
    runs = tuple(r.where(slice(None)) for r in case.runs[:2])
    for run in runs:
        run.signals["base_pos"] = run.signals["base_pos"] + [0.0, 0.0, 0.5]
    with pytest.raises(GapError, match="do not stand on the scene") as error:
        check_scene(case.with_runs(runs), load_terrain(lowered / "scene.xml"))
    assert "frame" in str(error.value)


def test_a_log_without_contacts_says_what_is_missing(lowered: Path) -> None:
    case = load_case(lowered / "case")
    runs = tuple(r.where(slice(None)) for r in case.runs[:1])
    del runs[0].signals["contact"]
    with pytest.raises(GapError, match="no contact"):
        check_scene(case.with_runs(runs), load_terrain(lowered / "scene.xml"))


def test_a_scene_that_runs_away_with_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text('<mujoco><asset><mesh file="/etc/passwd"/></asset></mujoco>')
    with pytest.raises(RealsimError, match="leads out"):
        load_terrain(tmp_path)
    with pytest.raises(GapError, match="no such scene"):
        load_terrain(tmp_path / "other.xml")


def test_tops_are_those_that_collide_and_stand_still(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(XML)
    terrain = load_terrain(tmp_path)
    top, geom = terrain.below(np.array([0.0, 0.0, 0.5]), 0.1)
    assert (top, terrain.name(geom)) == (pytest.approx(0.0), "ground")
    top, geom = terrain.below(np.array([0.3, 0.0, 0.09]), 0.05)  # from inside its top too
    assert (top, terrain.name(geom)) == (pytest.approx(0.1), "step")
    name, middle, _ = terrain.foothold(geom, np.array([0.3, 2 * CELL * 0.5, 0.1]))
    assert name == "step[+0,+1]"
    assert middle == pytest.approx([0.3, CELL])


def test_a_ball_beside_an_edge_is_held_by_the_edge(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(XML)
    terrain = load_terrain(tmp_path)
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(XML))
    ball = int(data.model.geom("ball").id)
    for x, expected in ((0.0, 0.03), (0.3, -0.07)):
        data.qpos[:3] = [x, 0.0, 0.05]
        mujoco.mj_forward(data.model, data)
        gap, _, low = clearance(terrain, data, [Part(ball, np.zeros((1, 3)), 0.02)])
        assert gap == pytest.approx(expected)
        assert low[:2] == pytest.approx([x, 0.0])
    data.qpos[:3] = [0.19, 0.0, 0.12]  # its middle is beyond the edge, its side above the step
    mujoco.mj_forward(data.model, data)
    gap, geom, _ = clearance(terrain, data, [Part(ball, np.zeros((1, 3)), 0.02)])
    assert terrain.name(geom) == "step"
    assert 0.0 <= gap <= 0.012


def test_the_model_of_contacts_is_not_led_by_a_few_that_err() -> None:
    rng = np.random.default_rng(0)
    group = np.repeat(np.arange(60), 5)
    A = np.column_stack([np.ones(300), rng.normal(size=300)])
    y = A @ [0.01, 0.004] + np.repeat(0.001 * rng.normal(size=60), 5) + 0.0005 * rng.normal(size=300)
    y[:20] += 0.1  # four contacts on something else
    found = fit(A, y, group, np.array([0.1, 0.1]), (0.004, 0.002))
    assert found.mean == pytest.approx([0.01, 0.004], abs=0.001)
    assert found.weights[:4].max() < 0.2 < found.weights[4:].min() + 0.2
    assert found.bayes([1], np.array([0.1])) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("value", [0.0, 0.05])
def test_evidence_is_the_ratio_of_two_likelihoods(value: float) -> None:
    """One observation of one parameter: N(y; 0, wide) over N(y; 0, narrow), in closed form."""
    found = fit(np.ones((1, 1)), np.array([value]), np.zeros(1, int), np.array([0.01]), (0.004, 0.002), robust=False)
    size = np.hypot(found.group_size, found.noise)
    want = norm.logpdf(value, 0, np.hypot(0.1, size)) - norm.logpdf(value, 0, np.hypot(0.01, size))
    got = fit(
        np.ones((1, 1)), np.array([value]), np.zeros(1, int), np.array([0.01]), (found.group_size, found.noise), False
    )
    assert got.bayes([0], np.array([0.1])) == pytest.approx(want, rel=0.35, abs=0.4)
