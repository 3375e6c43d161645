"""report.json has what was promised, report.html stands alone, and the verdict follows its stated rules."""

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

import realsim as rs
from realsim.core.errors import RealsimError
from realsim.core.types import AlignedScene, Dropped, Mode, Reconstruction
from realsim.report import write_report
from realsim.report.picture import draw
from realsim.report.topdown import map_from_above
from realsim.report.verdict import Check, Judgement, judge
from tests.pages import read

from .scene import reconstruction


def test_json_has_the_promised_fields(tmp_path: Path) -> None:
    write_report(tmp_path, reconstruction(tmp_path), picture=False)
    report = json.loads((tmp_path / "report.json").read_text())
    assert np.shape(report["T_sim_world"]) == (4, 4)
    assert set(report["scale"]) >= {"value", "ci90", "per_frame_spread", "method"}
    assert report["scale"]["ci90"] == [0.999, 1.003]
    assert set(report["gravity"]) >= {"normal_world", "tilt_sigma_deg", "inlier_rms_m"}
    for role, x in (("start", 0.0), ("goal", 3.0)):
        assert report[role]["centroid"] == [x, 0, 0]
        assert report[role]["size"] == [0.9, 0.8, 0.35]
    assert report["frames"]["used"] == [f"{i:06d}" for i in range(5)]
    assert report["frames"]["dropped"] == [{"name": "000009", "stage": "scale", "reason": "blurred <b>"}]
    assert [set(s) >= {"name", "seconds", "peak_mb"} for s in report["stages"]] == [True, True]
    assert report["contact"]["representation"] == "boxes"
    assert report["mesh"]["watertight"] is True
    assert {"realsim", "numpy", "mujoco"} <= set(report["versions"])
    assert report["warnings"] == []
    assert report["verdict"]["level"] == "good"


CLOCKED = ("step_cost_vs_plane", "walk_cost_vs_plane", "steps_per_second")


def test_same_result_same_bytes_whatever_it_cost(tmp_path: Path) -> None:
    """What differs is what docs/conventions.md lists."""
    pages, reports = [], []
    for seconds in (1.0, 2.0):
        result = reconstruction(tmp_path)
        contact = {**result.scene.contact, "median_mm": 1.0, "p95_mm": 2.0, **dict.fromkeys(CLOCKED, seconds)}
        scene = replace(result.scene, contact=contact)
        modes = (Mode("rgbd", scale=1.0, seconds=seconds), Mode("onnx", error="no model"))
        stages = tuple(replace(s, seconds=seconds) for s in result.stages)
        write_report(tmp_path, replace(result, stages=stages, scene=scene, modes=modes), picture=False)
        page = (tmp_path / "report.html").read_text()
        page = re.sub(r'<section class="card"><h3>This run.*?</section>|<footer>.*?</footer>', "", page)
        page = re.sub(rf"<tr><td[^>]*>({'|'.join(k.replace('_', ' ') for k in CLOCKED)})</td>.*?</tr>", "", page)
        pages.append(re.sub(rf"<td[^>]*>{seconds:.1f} s</td>", "", page))
        report = json.loads((tmp_path / "report.json").read_text())
        for part in (report, *report["modes"], report["contact"]):
            for key in ("made", "stages", "seconds", *CLOCKED):
                part.pop(key, None)
        reports.append(report)
    assert pages[0] == pages[1]
    assert reports[0] == reports[1]


def test_page_stands_alone_and_is_well_formed(tmp_path: Path) -> None:
    write_report(tmp_path, reconstruction(tmp_path), picture=False)
    text = (tmp_path / "report.html").read_text()
    assert "blurred <b>" in read(text)
    assert "blurred &lt;b&gt;" in text  # what comes from data is escaped
    assert len(text) < 6e6


@pytest.mark.parametrize("x_up", [False, True])
def test_the_map_shows_all_of_the_scene(tmp_path: Path, x_up: bool) -> None:
    """On a wide page the way goes from left to right, on a phone upwards; nothing lies outside of the picture."""
    result = reconstruction(tmp_path)
    drawings = re.findall(r'<svg class="plot.*?</svg>.*?</svg>', map_from_above(result.aligned, result.mesh), re.S)
    assert len(drawings) == 2
    drawing = ElementTree.fromstring(drawings[x_up])
    box = next(e for e in drawing if e.tag == "svg")
    x0, y0, width, height = (float(box.get(k, "nan")) for k in ("x", "y", "width", "height"))
    names = {e.text: (float(e.get("x", "nan")), float(e.get("y", "nan"))) for e in box.iter("text")}
    eyes = [(float(e.get("cx", "nan")), float(e.get("cy", "nan"))) for e in box.iter("circle")]
    assert len(eyes) == 2 * 5
    for x, y in [*names.values(), *eyes]:
        assert x0 <= x <= x0 + width
        assert y0 <= y <= y0 + height
    (sx, sy), (gx, gy) = names["start"], names["goal"]
    assert (gy < sy - 100) if x_up else (gx > sx + 100)
    assert (height > width) == x_up
    # The picture is turned with what is drawn over it: the start platform is where its name is.
    image = next(box.iter("image"))
    data = cv2.imdecode(np.frombuffer(base64.b64decode(image.get("href", "").split(",")[1]), np.uint8), -1)
    at = [
        int((v - lo) / size * n) for v, lo, size, n in ((sy, y0, height, data.shape[0]), (sx, x0, width, data.shape[1]))
    ]
    assert data[at[0], at[1], 3] == 255


def test_the_picture_is_of_the_scene_or_its_lack_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = reconstruction(tmp_path)
    write_report(tmp_path, result)
    text = (tmp_path / "report.html").read_text()
    assert ("image/webp" in text.split("In MuJoCo")[1][:400]) or "cannot draw" in text
    monkeypatch.setenv("MUJOCO_GL", "none of these")
    with pytest.raises(RealsimError, match="cannot draw"):
        draw(tmp_path / "scene.xml", 64, 48)


def test_a_step_is_said_once_where_it_says_most() -> None:
    checks = tuple(Check("", "", "", "look", "", advice) for advice in ("do it", "do it; here", ""))
    assert Judgement(checks).next_steps == ("do it; here",)


def test_advice_names_the_frames_and_the_place(tmp_path: Path) -> None:
    """What to do next is about this capture."""
    result = reconstruction(tmp_path)
    dropped = tuple(Dropped(f"{i:06d}", "reason") for i in range(100, 120))
    mesh = replace(result.mesh, invented=np.ones(len(result.mesh.triangles), bool))
    steps = " ".join(judge(replace(result, source=replace(result.source, dropped=dropped), mesh=mesh)).next_steps)
    assert "000100" in steps
    assert "17 more" in steps  # one was dropped at the scale already
    mesh = replace(mesh, statistics=mesh.statistics | {"unseen": {"share": 0.8, "look_from": [1.0, 2.0]}})
    steps = " ".join(judge(replace(result, mesh=mesh)).next_steps)
    assert "x 1.0, y 2.0 m" in steps
    assert "80" in steps


def test_scan_without_cameras_has_a_report(tmp_path: Path) -> None:
    write_report(tmp_path, reconstruction(tmp_path, scan=True), picture=False)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["frames"]["used"] == []
    assert report["scale"]["value"] == 1.0
    assert report["world"] == "scan"


def _with(result: Reconstruction, **changes: object) -> Reconstruction:
    aligned: AlignedScene = result.aligned
    metric = aligned.metric
    assert metric is not None
    if "ci90" in changes:
        metric = replace(metric, scale=replace(metric.scale, ci90=changes["ci90"]))
    if "tilt" in changes:
        aligned = replace(aligned, gravity=replace(aligned.gravity, tilt_sigma_deg=changes["tilt"]))
    if "platforms" in changes:
        aligned = replace(aligned, platforms=changes["platforms"])
    return replace(result, aligned=replace(aligned, metric=metric))


@pytest.mark.parametrize(
    ("changes", "level"),
    [
        ({}, "good"),
        ({"ci90": (0.98, 1.02)}, "look"),
        ({"ci90": (0.9, 1.1)}, "bad"),
        ({"ci90": (float("nan"), float("nan"))}, "bad"),
        ({"tilt": 0.4}, "look"),
        ({"tilt": 1.5}, "bad"),
        ({"platforms": ()}, "look"),
    ],
)
def test_verdict_follows_its_rules(tmp_path: Path, changes: dict[str, object], level: str) -> None:
    judgement = judge(_with(reconstruction(tmp_path), **changes))
    assert judgement.level == level
    assert bool(judgement.reasons) == (level != "good")


def _unseen(result: Reconstruction, **figures: object) -> Reconstruction:
    return replace(result, mesh=replace(result.mesh, statistics={"unseen": figures}))


def test_what_no_camera_saw_weighs_by_where_it_is(tmp_path: Path) -> None:
    """On the way it decides; beside it a person looks; where there is no way it never rejects."""
    result = reconstruction(tmp_path)
    areas = {"area_m2": 10.0, "way_area_m2": 4.0}
    assert judge(_unseen(result, **areas, unseen_m2=3.0, way_unseen_m2=3.0)).level == "bad"
    assert judge(_unseen(result, **areas, unseen_m2=1.0, way_unseen_m2=1.0)).level == "look"
    assert judge(_unseen(result, **areas, unseen_m2=5.5, way_unseen_m2=0.1)).level == "look"
    assert judge(_unseen(result, **areas, unseen_m2=2.0, way_unseen_m2=0.1)).level == "good"
    no_way = replace(result, aligned=replace(result.aligned, platforms=()))
    assert judge(_unseen(no_way, area_m2=10.0, unseen_m2=9.0)).level == "look"


def test_the_verdict_says_which_way_round_the_camera_should_go(tmp_path: Path) -> None:
    areas = {"area_m2": 10.0, "way_area_m2": 4.0, "unseen_m2": 2.0, "way_unseen_m2": 2.0, "share": 0.8}
    for at, words in (((1.5, 1.2), "left of the way"), ((1.5, -1.2), "right of the way"), ((4.2, 0.1), "beyond")):
        found = judge(_unseen(reconstruction(tmp_path), **areas, look_from=list(at)))
        assert any(words in step and "80" in step for step in found.next_steps)


@pytest.mark.parametrize(("gain", "level"), [(1.01, "good"), (0.975, "look"), (1.055, "bad"), (0.945, "bad")])
def test_metres_that_no_depth_camera_is_off_by_are_rejected(tmp_path: Path, gain: float, level: str) -> None:
    result = reconstruction(tmp_path)
    metric = result.aligned.metric
    assert metric is not None
    metric = replace(metric, depth_gain=gain)
    assert judge(replace(result, aligned=replace(result.aligned, metric=metric))).level == level


@pytest.mark.parametrize(
    ("through", "off", "held", "level"),
    [(0.0, 0.0, 0, "good"), (0.1, 0.0, 0, "look"), (0.99, 0.0, 0, "bad"), (0.0, 0.2, 0, "look"), (0.0, 0.0, 1, "look")],
)
def test_walls_that_are_not_there_are_rejected_and_slots_are_looked_at(
    tmp_path: Path, through: float, off: float, held: int, level: str
) -> None:
    result = reconstruction(tmp_path)
    sides = {"rays": 500, "stopped": 1 - through, "through": through, "early": 0.0}
    contact = {**result.scene.contact, "sides": sides, "drop": {"phantom_share": off, "missing_share": 0.0}}
    contact |= {"held": held}
    assert judge(replace(result, scene=replace(result.scene, contact=contact))).level == level


def test_a_warning_asks_for_a_look_and_is_the_reason(tmp_path: Path) -> None:
    found = judge(reconstruction(tmp_path, warnings=("two grounds", "dim light")))
    assert found.level == "look"
    assert found.reasons == ("Two grounds.", "Dim light.")
    assert found.headline == "Two grounds."


def test_what_decides_is_marked_and_what_is_not_to_be_used_does_not_begin_with_its_use(tmp_path: Path) -> None:
    result = reconstruction(tmp_path)
    areas = {"area_m2": 10.0, "way_area_m2": 4.0, "unseen_m2": 3.0, "way_unseen_m2": 3.0, "look_from": [1.5, 1.2]}
    result = _unseen(result, **areas, share=0.8)
    drops = [{"platform": "goal", "object": "box", "error_m": -0.05}]
    contact = {**result.scene.contact, "leak_places": [[1.0, 0.2, -0.3]]}
    result = replace(result, scene=replace(result.scene, contact=contact, checks={"drops": drops}))
    write_report(tmp_path, result, picture=False)
    text = read((tmp_path / "report.html").read_text())
    for words in ("fell through", "box: -50 mm", "look from here", "what decides the verdict", "no camera saw this"):
        assert words in text
    assert text.index("What the verdict rests on") < text.index("Use the scene")
    write_report(tmp_path, reconstruction(tmp_path), picture=False)
    text = read((tmp_path / "report.html").read_text())
    assert "what decides the verdict" not in text
    assert text.index("What the verdict rests on") > text.index("Use the scene")
    assert rs.__version__ in text


@pytest.mark.parametrize(("lost", "level"), [(False, "good"), (True, "bad")])
def test_good_frames_that_were_not_picked_do_not_count_against_a_scene(tmp_path: Path, lost: bool, level: str) -> None:
    result = reconstruction(tmp_path)
    dropped = tuple(Dropped(f"{i:06d}", "reason", lost) for i in range(100, 200))
    result = replace(result, source=replace(result.source, dropped=dropped))
    assert judge(result).level == level
    write_report(tmp_path, result, picture=False)
    assert len(json.loads((tmp_path / "report.json").read_text())["frames"]["dropped"]) == 101


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_browser_runs_the_page_without_errors(tmp_path: Path) -> None:
    write_report(tmp_path, reconstruction(tmp_path), picture=False)
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader"]
    command += ["--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"]
    command += [
        "--disable-sync",
        "--enable-unsafe-swiftshader",
        "--enable-logging=stderr",
        "--virtual-time-budget=2000",
    ]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", f"file://{tmp_path / 'report.html'}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, check=False)
    errors = [line for line in done.stderr.splitlines() if "CONSOLE" in line and ("Error" in line or "error" in line)]
    assert errors == []
    assert "<canvas" in done.stdout
    assert 'aria-pressed="true">mesh</button>' in done.stdout
