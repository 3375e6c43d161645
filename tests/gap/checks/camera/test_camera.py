"""Depth frames against the scene: what was done to the camera is found, and nothing where nothing was done."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from realsim.core.errors import GapError
from realsim.core.statistics import Interval
from realsim.gap.answer.camera import with_camera
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.case.case import Run, load_case
from realsim.gap.checks.camera import calibrate
from realsim.gap.checks.camera.calibrate import OF_ALL, CameraFound, jitter
from realsim.gap.checks.camera.recorded import depth_camera, read_frames
from realsim.gap.checks.footholds.run import check_camera
from realsim.gap.effects import EFFECTS
from realsim.gap.verdicts import GapVerdict
from tests.truths.crossings import Truth, make_case

TRUTHS = {
    "nothing": Truth(),
    "turned": Truth(camera_turn=(0.0349, 0.0, 0.0)),
    "shifted": Truth(camera_shift=(0.0, 0.01, 0.0)),
    "late_and_noisy": Truth(camera_delay=0.04, depth_noise=2.0),
}
NAMES = {"nothing": set(), "turned": {"camera_mount"}, "shifted": {"camera_mount"},
         "late_and_noisy": {"camera_delay", "depth_noise"}}  # fmt: skip


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, CameraFound]:
    """By a third of the usual frames, and two thirds of their pixels."""
    result = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrate, "FRAMES", 20)
        patch.setattr(calibrate, "PIXELS", 500)
        for seed, (name, truth) in enumerate(TRUTHS.items(), 20):
            folder = tmp_path_factory.mktemp(name)
            case = make_case(folder, truth, crossings=3, terrain_seed=seed, seed=seed, depth=True, cycles=1)
            camera = check_camera(load_case(case), folder / "scene.xml")
            assert camera is not None
            result[name] = camera
    return result


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUTHS)
def test_what_was_done_is_named_and_nothing_else(found: dict[str, CameraFound], name: str) -> None:
    assert set(found[name].named) == NAMES[name]
    assert {c["effect"] for c in found[name].causes()} == NAMES[name]
    assert len(found[name].sentences()) == len(NAMES[name])


def nearly_within(q: Interval, truth: float) -> bool:
    return q.low - 0.5 * (q.value - q.low) < truth < q.high + 0.5 * (q.high - q.value)


def test_values_are_recovered(found: dict[str, CameraFound]) -> None:
    late = found["late_and_noisy"]
    assert late.quantities["delay"].value == pytest.approx(0.04, abs=0.005)
    assert found["turned"].quantities["turn_x"].value == pytest.approx(0.0349, abs=0.007)
    # By 1 cm down in the camera, which looks down by 0.45 rad: how far it is lower is known well, how far back is not,
    # since a base that is off along the way does the same.
    (_, down, forward) = found["shifted"].along("shift")
    assert np.cos(0.45) * down.value + np.sin(0.45) * forward.value == pytest.approx(0.01 * np.cos(0.45), abs=0.002)
    assert nearly_within(down, 0.01)
    assert late.quantities["ratio"].value == pytest.approx(2.0, abs=0.15)
    for name in ("nothing", "turned"):
        assert found[name].quantities["ratio"].value == pytest.approx(1.0, abs=0.1)
    assert nearly_within(late.quantities["delay"], 0.04)
    assert nearly_within(found["turned"].quantities["turn_x"], 0.0349)
    assert found["turned"].after < 0.5 * found["turned"].before


def test_a_diagnosis_has_the_camera_among_its_causes(found: dict[str, CameraFound]) -> None:
    plain = Diagnosis(GapVerdict.NO_GAP, "No gap.", "", (), (), (), {}, 0.0, {})
    assert with_camera(plain, None) is plain
    assert with_camera(plain, found["nothing"]).verdict == "no_gap"
    late = with_camera(plain, found["late_and_noisy"])
    assert late.verdict == "identified"
    assert late.causes[0]["effect"] == "camera_delay"
    assert "late by" in late.sentence
    assert "no gap" in late.sentence
    assert late.advice == "correct the camera; change nothing else in the model"
    assert late.causes[0]["probability"] is None
    assert late.as_dict()["statistics"]["camera"]["camera"] == "head"


@pytest.fixture(scope="module")
def crossed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_case(tmp_path_factory.mktemp("crossed"), Truth(), crossings=1, seed=3, depth=True, cycles=1)


@pytest.fixture
def case(crossed: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copytree(crossed, tmp_path / "case"))


def _say(case: Path, **change: object) -> None:
    said = json.loads((case / "log.json").read_text())
    said["depth_camera"] = {**said["depth_camera"], **change}
    (case / "log.json").write_text(json.dumps(said))


def test_a_log_without_a_camera_is_left_alone(case: Path) -> None:
    said = json.loads((case / "log.json").read_text())
    del said["depth_camera"]
    (case / "log.json").write_text(json.dumps(said))
    assert depth_camera(load_case(case)) is None
    assert check_camera(load_case(case), None) is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera": "haed"}, "not in model.xml"),
        ({"fx": "wide"}, "cannot be read"),
        ({"noise": [0, 0]}, "cannot be read"),
        ({"fx": -1}, "cannot be read"),
    ],
)
def test_a_camera_that_cannot_be_read_is_refused(case: Path, change: dict, message: str) -> None:
    _say(case, **change)
    with pytest.raises(GapError, match=message):
        depth_camera(load_case(case))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth": None}, "cannot be read"),
        ({"depth_time": np.zeros(3)}, "cannot be read"),
        ({"depth_time": "back"}, "does not increase"),
        ({"depth": None, "depth_time": None}, "no run has depth"),
    ],
)
def test_frames_that_cannot_be_read_are_refused(case: Path, change: dict, message: str) -> None:
    path = next((case / "runs").glob("*.npz"))
    arrays = dict(np.load(path))
    for name, value in change.items():
        if isinstance(value, str):
            arrays[name] = arrays[name][::-1]
        elif value is None:
            del arrays[name]
        else:
            arrays[name] = value
    np.savez(path, **arrays)
    loaded = load_case(case)
    camera = depth_camera(loaded)
    assert camera is not None
    with pytest.raises(GapError, match=message):
        read_frames(loaded, camera, 10, 100)


def test_millimetres_are_metres(case: Path) -> None:
    loaded = load_case(case)
    camera = depth_camera(loaded)
    assert camera is not None
    before, rays = read_frames(loaded, camera, 10, 100)
    path = next((case / "runs").glob("*.npz"))
    arrays = dict(np.load(path))
    arrays["depth"] = np.rint(1000 * arrays["depth"]).astype(np.uint16)
    np.savez(path, **arrays)
    after, _ = read_frames(loaded, camera, 10, 100)
    assert after[0].depth == pytest.approx(before[0].depth, abs=6e-4)
    assert rays[0] == pytest.approx([-15.5 / camera.fx, -11.5 / camera.fy, 1.0])
    shutil.rmtree(case)


def _frames_in_a_folder(case: Path, suffix: str) -> Path:
    path = next((case / "runs").glob("*.npz"))
    arrays = dict(np.load(path))
    depth, time = arrays.pop("depth"), arrays.pop("depth_time")
    np.savez(path, **arrays)
    folder = case / "runs" / f"{path.stem}_depth"
    folder.mkdir()
    lines = ["# time file"]
    for k, (t, image) in enumerate(zip(time, np.asarray(depth, float), strict=True)):
        if suffix == ".png":
            cv2 = pytest.importorskip("cv2", reason="needs the extra `recon`")
            cv2.imwrite(str(folder / f"{k:04}.png"), np.rint(1000 * np.nan_to_num(image)).astype(np.uint16))
        else:
            np.save(folder / f"{k:04}.npy", image)
        lines.append(f"{t!r} {k:04}{suffix}".replace("np.float64(", "").replace(")", ""))
    (folder / "depth.txt").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.parametrize("suffix", [".png", ".npy"])
def test_frames_in_a_folder_are_those_of_the_arrays(case: Path, suffix: str) -> None:
    camera = depth_camera(load_case(case))
    assert camera is not None
    before, rays = read_frames(load_case(case), camera, 10, 100)
    _frames_in_a_folder(case, suffix)
    after, same = read_frames(load_case(case), camera, 10, 100)
    assert after[0].time == pytest.approx(before[0].time, abs=1e-9)
    assert after[0].depth == pytest.approx(before[0].depth, abs=6e-4)
    assert np.array_equal(rays, same)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "depth.txt").unlink(), "have no times"),
        (lambda folder: (folder / "depth.txt").write_text("0.1\n"), "line 1 cannot be read"),
        (lambda folder: (folder / "depth.txt").write_text("0.1 none.npy\n"), "not there"),
        (lambda folder: (folder / "depth.txt").write_text("# nothing\n"), "no depth frame is listed"),
        (lambda folder: (folder / "depth.txt").write_text("0.2 0000.npy\n0.1 0001.npy\n"), "does not increase"),
        (lambda folder: (folder / "0000.npy").write_bytes(b"\x93NUMPY"), "damaged"),
        (lambda folder: np.save(folder / "0000.npy", np.zeros((3, 3, 3))), "not a depth frame"),
        (lambda folder: np.save(folder / "0000.npy", np.zeros((3, 3))), "different sizes"),
    ],
)
def test_a_folder_of_frames_that_cannot_be_read_is_refused(case: Path, damage: object, message: str) -> None:
    damage(_frames_in_a_folder(case, ".npy"))  # type: ignore[operator]
    loaded = load_case(case)
    camera = depth_camera(loaded)
    assert camera is not None
    with pytest.raises(GapError, match=message):
        read_frames(loaded, camera, 10, 100)


@pytest.mark.parametrize("name", ["camera_delay", "camera_mount", "depth_noise"])
def test_the_search_over_motions_says_where_they_are_told(name: str) -> None:
    assert "depth frames" in EFFECTS[name].words.excitation[0]


def test_what_all_runs_share_stays_in_the_interval(found: dict[str, CameraFound]) -> None:
    """A lean that feet or an IMU err by alike in all runs looks like a turned mount, however many pixels there are."""
    for camera in found.values():
        turn = camera.quantities["turn_x"]
        assert (turn.high - turn.low) / 2 / 1.645 > 0.9 * OF_ALL[4] * np.cos(0.45)


@pytest.mark.parametrize(("metres", "radians"), [(0.0, 0.0), (0.001, 0.002)])
@pytest.mark.parametrize("slower", [1, 5])
def test_how_much_a_pose_errs_by_itself_is_read_off_the_log(metres: float, radians: float, slower: int) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0, 60, 0.01 * slower)
    pos = np.stack([0.2 * t, 0.05 * np.sin(t), 0.3 + 0.01 * np.cos(t)], axis=1)
    pos += metres * rng.normal(size=pos.shape)
    turn = Rotation.from_rotvec(np.outer(0.3 * np.sin(t), [0, 0, 1]) + radians * rng.normal(size=pos.shape))
    rows = np.arange(0, t[-1], 0.01)
    between = {name: np.stack([np.interp(rows, t, v) for v in values.T], axis=1)
               for name, values in (("base_pos", pos), ("base_quat", turn.as_quat(scalar_first=True)))}  # fmt: skip
    found = jitter(Run("a", rows, rows[:, None], between))
    np.testing.assert_allclose(found[:3], metres, rtol=0.1, atol=1e-4)
    np.testing.assert_allclose(found[3:], radians, rtol=0.1, atol=4e-4)
