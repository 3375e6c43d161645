"""The report of a diagnosis stands alone, says what was found, and leaves out what it cannot show with a reason."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from realsim.gap import DiagnoseConfig, Diagnosis, diagnose, load_case
from realsim.gap.report import diagnosis_page, write_report
from realsim.gap.report.evidence import model_changes
from realsim.gap.report.plots import _labelled_bars, rival_label
from realsim.gap.report.robot import body_shares
from realsim.gap.report.series import horizons, worst_windows
from realsim.gap.report.words import percent, short
from realsim.gap.simulation.simulate import Simulator, measured
from realsim.gap.verdicts import WORDINGS
from realsim.report.solids import solids
from tests.pages import read

from .truth import Truth

EFFECTS = ("coulomb_friction", "ground_friction")


@pytest.fixture(scope="module")
def found(made: Callable[..., Path]) -> Diagnosis:
    folder = made(Truth(coulomb={"shoulder": 4.0}), runs=3, span=(2.2, 2.6))
    return diagnose(load_case(folder), DiagnoseConfig(effects=EFFECTS, threads=1, bootstrap=50))


def test_page_says_what_was_found(found: Diagnosis, tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", found)
    text = read((tmp_path / "report.html").read_text())
    assert found.sentence in text
    assert WORDINGS[found.verdict].word in text
    assert found.advice in text
    assert "s of simulation" in text
    for title in ("Where", "What", "How much", "Before and after", "Apply the patch", "Data health", "All effects"):
        assert title in text
    for row in found.ranking:
        assert row["effect"] in text or row["outcome"].removeprefix("not tried: ") in text
    assert "with the diagnosis" in text
    assert "apply_patch" in text


def test_what_stays_is_no_evidence_for_the_cause(found: Diagnosis) -> None:
    looks = ({"joint": "elbow", "what": "damping-like", "explains": 0.5},)
    assert "the rest looks damping-like at elbow" in read(diagnosis_page(replace(found, looks_like=looks)))


def test_same_diagnosis_same_bytes(found: Diagnosis) -> None:
    assert diagnosis_page(found) == diagnosis_page(found)


def test_text_from_the_log_is_escaped(found: Diagnosis) -> None:
    health = {**found.health, "warnings": ["run <script>alert(1)</script>"]}
    html = diagnosis_page(replace(found, sentence="a <b> & c", health=health))
    assert "<script>alert" not in html
    assert "a &lt;b&gt; &amp; c" in html


def test_without_evidence_every_missing_part_has_a_reason(found: Diagnosis) -> None:
    text = read(diagnosis_page(replace(found, evidence=None)))
    assert found.sentence in text
    assert "were not kept with this diagnosis" in text


def test_no_gap_asks_for_nothing(found: Diagnosis) -> None:
    assert found.evidence is not None
    kept = replace(found.evidence, after=(), shots=found.evidence.shots[:1], reason="No cause was found.")
    none = replace(found, verdict="no_gap", sentence="No gap.", causes=(), ranking=(), evidence=kept)
    text = read(diagnosis_page(none))
    assert "No effect had to be fitted" in text
    assert "No cause was found" in text
    assert "Apply the patch" not in text


def test_ambiguous_names_the_other_set_and_what_would_tell(found: Diagnosis) -> None:
    other = ({**found.causes[0], "effect": "viscous_friction"},)
    unsure = replace(found, verdict="ambiguous", equivalent=(other,))
    text = read(diagnosis_page(unsure))
    assert "Cannot be distinguished" in text
    assert "viscous friction" in text.lower()
    assert "What to record to decide" in text
    planned = replace(unsure, next_experiment={"motion": "slow ramps on the elbow", "seconds": 6.0})
    assert "slow ramps on the elbow" in read(diagnosis_page(planned))


def test_evidence_of_where_is_shown(found: Diagnosis) -> None:
    text = read(diagnosis_page(found))
    assert "joints, 20 ms ahead" in text
    assert "Wrench that the base lacks" not in text  # a fixed base
    axes = [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"]
    wrench = {a: {"value": -15.0, "unit": "N", "ci90": [-17.0, -12.0]} for a in axes} | {"mass_kg": 1.53}
    term = {"what": "against the velocity, of constant size", "value": 0.5, "unit": "N m", "explains": 0.9}
    more = found.statistics | {
        "base_wrench": wrench,
        "torque_residual": {"elbow": {"rms_Nm": 0.5, "share": 0.1, **term}},
    }
    text = read(diagnosis_page(replace(found, statistics=more)))
    assert "weighs 1.5 kg (more than the model)" in text
    assert "against the velocity, of constant size: 0.5 N m (90 %)" in text


def test_patch_that_needs_a_wrapper_says_what_to_do(found: Diagnosis) -> None:
    late = {"value": 0.012, "unit": "s", "what": "hold back every command by this time"}
    text = read(diagnosis_page(replace(found, patch={**found.patch, "wrappers": {"command_delay": late}})))
    assert "The loop must do the rest" in text
    assert "hold back every command by this time" in text


def test_nothing_is_simulated_for_the_page(found: Diagnosis, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a report simulates")

    monkeypatch.setattr(Simulator, "__init__", refuse)
    monkeypatch.setattr(Simulator, "simulate", refuse)
    monkeypatch.setattr(Simulator, "roll_out", refuse)
    assert "Before and after" in diagnosis_page(found)


def test_effects_are_drawn_without_left_out_runs_too(found: Diagnosis) -> None:
    rows = tuple(r | {"heldout_gain": None, "heldout_se": None} for r in found.ranking)
    text = read(diagnosis_page(replace(found, ranking=rows)))
    assert "explains the fitted runs; 100 % is the best one" in text


def test_no_word_of_statistics_that_means_nothing_to_a_roboticist(found: Diagnosis) -> None:
    text = read(diagnosis_page(found)).lower()
    for word in ("likelihood", "nats", "evidence gain", "posterior"):
        assert word not in text


def test_a_bar_beyond_the_picture_has_its_figure_above_it() -> None:
    svg = _labelled_bars([("nominal", 1.0, 1.0, 1.0, "red", "100 %"), ("far", 5.66, 5.66, 5.66, "red", "566 %")],
                         (-0.02, 1.3), "")  # fmt: skip
    (place,) = re.findall(r'<text x="([0-9.]+)" y="([0-9.]+)"[^>]*>566 %', svg)
    bars = re.findall(r'<rect x="([0-9.]+)" y="([0-9.]+)" width="([0-9.]+)" height="([0-9.]+)"', svg)
    top = max(float(y) for _, y, _, _ in bars)
    assert float(place[1]) <= top  # the baseline of the text lies above the lowest bar


def test_runs_of_the_check_get_closer(found: Diagnosis) -> None:
    kept = found.evidence
    assert kept is not None
    assert [kept.case.runs[i].name for i in kept.runs] == list(found.shrinkage["runs"])
    real = measured(kept.case.runs[kept.runs[0]], kept.channels)
    before, after = (float(np.nanmean((real - y[0]) ** 2)) for y in (kept.before, kept.after))
    assert after < 0.5 * before
    ahead = horizons(kept)
    assert [label for label, _, _ in ahead] == ["one sample", "20 ms", "100 ms", "500 ms"]
    assert all(a is not None and a < 1.05 * b for _, b, a in ahead)  # one sample ahead, noise is all there is
    assert ahead[-1][2] < 0.5 * ahead[-1][1]  # type: ignore[operator]


def test_worst_windows_show_different_things(found: Diagnosis) -> None:
    kept = found.evidence
    assert kept is not None
    windows = worst_windows(kept, seconds=0.8, count=4)
    assert len(windows) == len(set(windows)) == 4
    assert {c for _, c, _, _ in windows} == set(range(len(kept.channels)))
    for k, _, start, end in windows:
        assert start >= 0
        assert end <= kept.case.runs[kept.runs[k]].duration + 0.1


def test_body_shares_are_shares(found: Diagnosis) -> None:
    assert found.evidence is not None
    shares = body_shares(found.evidence)
    assert shares.min() >= 0
    assert shares.sum() == pytest.approx(1.0, abs=1e-6)


def test_changes_of_the_model_are_those_of_the_causes(found: Diagnosis) -> None:
    assert found.evidence is not None
    lines = model_changes(found.evidence).splitlines()
    changed = {joint for c in found.causes for joint in c["joints"]}
    assert "shoulder" in changed
    for sign in "-+":
        mine = [line for line in lines if line[0] == sign]
        assert {line.split('name="')[1].split('"')[0] for line in mine} == changed
        assert all("frictionloss" in line for line in mine)


SHAPES = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="a" pos="0 0 1"><freejoint/>
      <geom type="box" size=".1 .2 .3"/>
      <geom type="sphere" size=".1" pos="1 0 0"/>
      <geom type="capsule" size=".05 .2" pos="2 0 0"/>
      <geom type="cylinder" size=".05 .2" pos="3 0 0"/>
      <geom type="ellipsoid" size=".1 .2 .3" pos="4 0 0"/>
      <body name="bare" pos="0 0 .5"><joint name="j" axis="1 0 0"/>
        <inertial pos="0 0 .2" mass="1" diaginertia=".1 .1 .1"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def test_shapes_have_the_size_of_their_geoms() -> None:
    model = mujoco.MjModel.from_xml_string(SHAPES)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    drawn = solids(model, data)
    parts = [V for body, (V, _) in drawn if body == model.body("a").id]
    sizes = [[0.2, 0.4, 0.6], [0.2, 0.2, 0.2], [0.1, 0.1, 0.5], [0.1, 0.1, 0.4], [0.2, 0.4, 0.6]]
    for i, (V, size) in enumerate(zip(parts, sizes, strict=True)):
        assert np.ptp(V, axis=0) == pytest.approx(size, rel=0.03)
        assert (V.min(axis=0) + V.max(axis=0)) / 2 == pytest.approx([i, 0, 1], abs=2e-3)
    assert all(F.min() >= 0 and F.max() < len(V) for _, (V, F) in drawn)
    bare = np.vstack([V for body, (V, _) in drawn if body == model.body("bare").id])
    assert bare[:, 2].max() > 1.85  # a rod through the centre of mass, and as far again
    assert len(solids(model, data, planes=False)) == len(drawn) - 1


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0, "0 %"), (1e-6, "<0.1 %"), (0.004, "0.4 %"), (0.83, "83 %"), (0.9999, ">99.9 %"), (1.0, "100 %"),
     (-0.126, "−13 %"), (1.27, "127 %"), (float("nan"), "–")],
)  # fmt: skip
def test_percent_never_rounds_to_all_or_nothing(share: float, text: str) -> None:
    assert percent(share) == text


def test_long_names_are_cut() -> None:
    assert short("left_hip_pitch_joint") == "left hip pitch"
    assert len(short("a" * 40)) == 20


def test_a_rival_fits_above_its_bar() -> None:
    wide = {"effect": "terrain_wobble", "place": [f"block_{i}" for i in range(4)], "stage": 2}
    assert rival_label("✓ ", wide) == "✓ wobbling support · block 0 and 3 more, after 2 causes"
    endless = {"effect": "terrain_wobble", "place": ["a_name_without_end_" * 5] * 3, "stage": 1}
    assert len(rival_label("", endless)) <= 58
