"""Bad logs are refused with the reason, or mended and said."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from realsim.core.errors import GapError, RealsimError, UnknownNameError
from realsim.gap import DiagnoseConfig, diagnose, explain, load_case
from realsim.gap.case.split import replicates
from realsim.gap.pipeline import limited
from realsim.gap.run import check_case, run_case
from tests.truths.written import write_case

from .truth import Truth

TETRA = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
FOUR_BAR = """
<mujoco>
  <option timestep="0.002"/>
  <default><geom type="capsule" size=".01" mass=".3" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body pos="0 0 1"><joint name="crank" axis="0 1 0" damping=".1"/><geom fromto="0 0 0 0 0 .1"/>
      <body name="bar" pos="0 0 .1"><joint name="coupler" axis="0 1 0"/><geom fromto="0 0 0 .3 0 .05"/></body></body>
    <body name="end" pos=".3 0 1"><joint name="rocker" axis="0 1 0"/><geom fromto="0 0 0 0 0 .15"/></body>
  </worldbody>
  <equality><connect body1="bar" body2="end" anchor=".3 0 .05"/></equality>
  <actuator><position name="motor" joint="crank" kp="30" kv="2" forcerange="-10 10"/></actuator>
</mujoco>"""


@pytest.fixture
def case(made, tmp_path: Path) -> Path:
    """A private copy to spoil."""
    folder = tmp_path / "case"
    shutil.copytree(made(Truth()), folder)
    return folder


def change(folder: Path, run: str = "run_01", **arrays: object) -> None:
    path = folder / "runs" / f"{run}.npz"
    with np.load(path) as data:
        kept = dict(data)
    for name, value in arrays.items():
        new = value(kept[name]) if callable(value) else value
        if new is None:
            kept.pop(name)
        else:
            kept[name] = new
    np.savez(path, **kept)


def only_one_run(folder: Path) -> None:
    for path in sorted((folder / "runs").glob("*.npz"))[1:]:
        path.unlink()


def relog(folder: Path, **values: object) -> None:
    log = json.loads((folder / "log.json").read_text())
    (folder / "log.json").write_text(json.dumps(log | values))


def test_reads_what_was_written(case: Path) -> None:
    found = load_case(case)
    assert found.joint_names == ("shoulder", "elbow")
    assert len(found.runs) == 4
    assert found.runs[0].time[0] == 0
    assert found.actuator_of("elbow") == "elbow_servo"
    assert not found.floating


@pytest.mark.parametrize("name", ["log.json", "model.xml"])
def test_missing_file_is_named(case: Path, name: str) -> None:
    (case / name).unlink()
    with pytest.raises(GapError, match=name):
        load_case(case)


@pytest.mark.parametrize("name", ["time", "command", "joint_pos"])
def test_missing_array_is_named(case: Path, name: str) -> None:
    only_one_run(case)
    change(case, **{name: lambda a: None})
    with pytest.raises(GapError, match=name):
        load_case(case)


def test_wrong_joint_name_gives_the_closest(case: Path) -> None:
    relog(case, joint_names=["sholder", "elbow"])
    with pytest.raises(GapError, match="did you mean shoulder"):
        load_case(case)


def test_entries_of_log_json_that_nothing_reads_are_said(case: Path) -> None:
    log = json.loads((case / "log.json").read_text())
    (case / "log.json").write_text(json.dumps(log | {"contact_body": ["hand"], "robot\x1b[31m": 3}))
    assert load_case(case).warnings[:2] == (
        "log.json: 'contact_body' is not read (did you mean contact_bodies?)",
        "log.json: 'robot\\x1b[31m' is not read",
    )


@pytest.mark.parametrize(
    ("log", "said"),
    [
        ({"contact_bodies": 5}, r"contact_bodies cannot be read[\s\S]*a list of names"),
        ({"contact_bodies": ["fore", 5]}, "contact_bodies cannot be read"),
        ({"contact_bodies": ["for"]}, "did you mean fore"),
        ({"imu_site": 5}, "imu_site cannot be read"),
        ({"imu_site": "wrst"}, "did you mean wrist"),
        ({"units": {"joint_position": "deg"}}, r"joint_position[\s\S]*did you mean joint_pos"),
        ({"units": {"joint_pos": 5}}, r"units of log.json cannot be read[\s\S]*log.json"),
        ({"joint_names": None}, "joint_names is missing"),
        ({"joint_names": 5}, "joint_names cannot be read"),
    ],
)
def test_what_log_json_cannot_mean_is_refused(case: Path, log: dict[str, object], said: str) -> None:
    relog(case, **log)
    with pytest.raises(GapError, match=said):
        load_case(case)


@pytest.mark.parametrize("dtype", [[("a", float), ("b", float)], "U4"])
def test_arrays_that_are_no_numbers_are_named(case: Path, dtype: object) -> None:
    only_one_run(case)
    change(case, mode=np.zeros(3, dtype=dtype))
    with pytest.raises(GapError, match=r"plain numbers[\s\S]*mode of type"):
        load_case(case)


def test_mismatched_lengths(case: Path) -> None:
    only_one_run(case)
    change(case, joint_pos=lambda a: a[:-3])
    with pytest.raises(GapError, match="wrong shape"):
        load_case(case)


def test_one_broken_run_is_left_out_and_said(case: Path) -> None:
    (case / "runs" / "run_02.npz").write_bytes(b"not a zip")
    found = load_case(case)
    assert len(found.runs) == 3
    assert "run_02" in found.dropped_runs[0]


def test_clock_that_runs_backwards_is_refused(case: Path) -> None:
    only_one_run(case)
    change(case, time=lambda t: t[::-1].copy())
    with pytest.raises(GapError, match="backwards"):
        load_case(case)


def test_a_single_late_stamp_is_left_out_and_said(case: Path) -> None:
    def late(t):
        t = t.copy()
        t[50] = t[40]
        return t

    change(case, time=late)
    assert any("backwards" in w for w in load_case(case).warnings)


def test_nan_stretches_are_borne(case: Path) -> None:
    def holes(a):
        a = a.copy()
        a[100:180] = np.nan
        return a

    change(case, joint_pos=holes)
    found = diagnose(load_case(case), DiagnoseConfig(effects=("command_delay",), report=False))
    assert found.verdict in ("no_gap", "unexplained", "identified", "ambiguous")


def test_all_nan_joint_is_refused(case: Path) -> None:
    only_one_run(case)
    change(case, joint_pos=lambda a: np.full_like(a, np.nan))
    with pytest.raises(GapError, match="no finite position"):
        load_case(case)


def test_constant_commands_do_not_excite(case: Path) -> None:
    for path in (case / "runs").glob("*.npz"):
        change(case, path.stem, command=lambda c: np.repeat(c[:1], len(c), axis=0))
    with pytest.raises(GapError, match="no run excites"):
        diagnose(load_case(case))


def test_exploding_model_is_named_with_the_time(case: Path) -> None:
    xml = (case / "model.xml").read_text()
    servo = '<position name="shoulder_servo" joint="shoulder" kp="150" kv="8" forcerange="-45 45"/>'
    assert servo in xml
    wild = '<general name="shoulder_servo" joint="shoulder" biastype="affine" gainprm="1e7" biasprm="0 0 0"/>'
    (case / "model.xml").write_text(xml.replace(servo, wild))
    with pytest.raises(GapError, match=r"explodes[\s\S]*run_01"):
        diagnose(load_case(case))


def test_torque_in_other_units_is_refused_until_log_json_says_so(made, tmp_path: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(made(Truth(), torque="measured"), folder)
    for path in (folder / "runs").glob("*.npz"):
        change(folder, path.stem, joint_torque=lambda t: 1000 * t)
    with pytest.raises(GapError, match="joint_torque looks like mN m"):
        check_case(folder)
    log = json.loads((folder / "log.json").read_text()) | {"units": {"joint_torque": "mN m"}}
    (folder / "log.json").write_text(json.dumps(log))
    assert not any("N m" in w for w in check_case(folder)["health"]["warnings"])


def test_one_run_only_is_said(case: Path) -> None:
    only_one_run(case)
    found = diagnose(load_case(case), DiagnoseConfig(effects=("command_delay", "coulomb_friction")))
    assert found.shrinkage["unseen"] is False
    assert any("only one run" in w for w in found.health["warnings"])


def repeated(case: Path, name: str, differs: float) -> None:
    """The first run once more, with positions that differ by so much."""
    arrays = dict(np.load(case / "runs" / "run_01.npz"))
    np.savez(case / "runs" / f"{name}.npz", **arrays | {"joint_pos": arrays["joint_pos"] + differs})


def test_many_runs_are_subsampled_and_said(case: Path) -> None:
    for i in range(20):
        repeated(case, f"more_{i:02d}", 1e-5 * (i + 1))
    found = diagnose(load_case(case), DiagnoseConfig(effects=("command_delay",), max_runs=4))
    assert any("24 runs" in w for w in found.health["warnings"])


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ('<compiler meshdir="/usr/share"/>', "leads out"),
        ('<asset><mesh name="m" file="../secret.stl"/></asset>', "leads out"),
        ('<include file="more.xml"/>', "leads out"),
        ('<include file="model.xml"/>', "include each other"),
        ('<asset><texture name="t" type="cube" fileright="../right.png"/></asset>', "leads out"),
        ('<asset><model name="m" file="parts/evil.xml"/></asset>', "leads out"),
        ('<asset><model name="m" file="parts/loop.xml"/></asset>', "include each other"),
        ('<asset><model name="m" file="parts/code.xml"/></asset>', "plugins"),
        ('<asset><mesh name="m" file="CASE/tetra.obj"/></asset>', "absolute path"),
        ('<compiler meshdir="CASE"/>', "absolute path"),
        ('<extension><plugin plugin="mujoco.pid"/></extension>', "plugins"),
    ],
)
def test_model_that_reaches_out_of_its_folder_is_refused(case: Path, line: str, error: str) -> None:
    (case / "more.xml").write_text('<mujoco><asset><texture name="t" type="2d" file="/etc/passwd"/></asset></mujoco>')
    (case / "parts").mkdir()
    for name, asset in (
        ("evil", '<hfield name="h" file="../../secret.png"/>'),
        ("loop", '<model name="m" file="loop.xml"/>'),
        ("code", '<model name="m" file="../code.xml"/>'),
    ):
        (case / "parts" / f"{name}.xml").write_text(f"<mujoco><asset>{asset}</asset></mujoco>")
    (case / "code.xml").write_text('<mujoco><extension><plugin plugin="mujoco.pid"/></extension></mujoco>')
    (case / "tetra.obj").write_text(TETRA)
    insert(case, line.replace("CASE", str(case)))
    with pytest.raises(RealsimError, match=error):
        load_case(case)


def insert(case: Path, line: str, before: str = "") -> None:
    """Write a line into model.xml: at its beginning, or before another text."""
    path = case / "model.xml"
    text = path.read_text()
    at = text.index(before) if before else text.index(">", text.index("<mujoco")) + 1
    path.write_text(text[:at] + line + text[at:])


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [('mass="1.6"', 'mass="1e30"', "body_mass"), ('damping="0.12"', 'damping="nan"', "dof_damping")],
)
def test_numbers_that_no_robot_has_are_refused(case: Path, old: str, new: str, field: str) -> None:
    """MuJoCo compiles them without a word, and simulates what is not a number."""
    path = case / "model.xml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(GapError, match=field):
        load_case(case)


def test_a_model_of_parts_is_read(case: Path) -> None:
    """A mesh in a model of its own, in a folder of its own; its name is relative to that."""
    (case / "parts").mkdir()
    (case / "meshes").mkdir()
    (case / "meshes" / "tetra.obj").write_text(TETRA)
    (case / "parts" / "tip.xml").write_text(
        '<mujoco><asset><mesh name="tip" file="../meshes/tetra.obj"/></asset><worldbody><body name="tip">'
        '<geom type="mesh" mesh="tip" mass="0.01" contype="0" conaffinity="0"/></body></worldbody></mujoco>'
    )
    insert(case, '<asset><model name="tip" file="parts/tip.xml"/></asset>')
    insert(case, '<attach model="tip" body="tip" prefix="a_"/>', before='<site name="wrist"')
    assert load_case(case).model.nmesh == 1


@pytest.mark.parametrize(("name", "error"), [("../tetra.obj", "leads out"), ("gone.obj", "cannot be read")])
def test_files_that_the_patched_model_would_not_find_are_refused_first(
    case: Path, tmp_path: Path, name: str, error: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("realsim.gap.run.asset_files", lambda spec: [name])
    said: list[str] = []
    with pytest.raises(RealsimError, match=error):
        run_case(case, tmp_path / "out", progress=lambda what, share: said.append(what))
    assert not said


def test_model_with_an_entity_bomb_is_refused(case: Path) -> None:
    (case / "model.xml").write_text('<!DOCTYPE a [<!ENTITY b "c">]><mujoco>&b;</mujoco>')
    with pytest.raises(GapError, match="plain XML"):
        load_case(case)


def test_tendons_and_loops_are_borne_and_said(case: Path) -> None:
    xml = (case / "model.xml").read_text()
    extra = (
        '<tendon><fixed name="strap"><joint joint="shoulder" coef="1"/>'
        '<joint joint="elbow" coef="0.1"/></fixed></tendon>'
        '<equality><joint joint1="elbow" joint2="shoulder" active="false"/></equality></mujoco>'
    )
    (case / "model.xml").write_text(xml.replace("</mujoco>", extra))
    found = load_case(case)
    assert any("tendon" in w for w in found.warnings)
    assert any("closed loops" in w for w in found.warnings)


def test_a_closed_loop_is_diagnosed(tmp_path: Path) -> None:
    """A four-bar linkage whose crank has friction that the model lacks."""
    runs, model = {}, mujoco.MjModel.from_xml_string(FOUR_BAR)
    model.dof_frictionloss[0] = 0.3
    for seed in range(3):
        rng, data = np.random.default_rng(seed), mujoco.MjData(model)
        mujoco.mj_step(model, data, 1000)
        start, rows = data.time, []
        for k in range(1200):
            if k % 5 == 0:
                t = data.time - start
                data.ctrl[0] = 0.4 * np.sin(2 * np.pi * (0.4 + 0.3 * seed) * t) * min(t, 1)
                rows.append([t, data.ctrl[0], *(data.qpos + rng.normal(0, 2e-4, 3))])
            mujoco.mj_step(model, data)
        R = np.array(rows)
        runs[f"run_{seed}"] = {"time": R[:, 0], "command": R[:, 1:2], "joint_pos": R[:, 2:]}
    case = load_case(write_case(tmp_path, FOUR_BAR, runs))
    found = diagnose(case, DiagnoseConfig(effects=("coulomb_friction", "command_delay"), threads=1))
    assert any("closed loops" in w for w in found.health["warnings"])
    assert found.causes[0]["effect"] == "coulomb_friction"
    assert found.causes[0]["joints"] == ["crank"]


def test_long_runs_with_few_samples_at_first_are_left_out_and_said(case: Path) -> None:
    change(case, "run_02", time=lambda t: 20 * t, command=lambda c: c + 1e-4 * np.arange(len(c))[:, None])
    config = DiagnoseConfig(effects=("command_delay",), max_seconds=2.0, bootstrap=20)
    found = diagnose(load_case(case), config)
    assert "left out: run_02 has less than 20 samples until then" in found.health["warnings"]
    for path in (case / "runs").glob("*.npz"):
        change(case, path.stem, time=lambda t: 30 * t)
    with pytest.raises(GapError, match=r"too short[\s\S]*max_seconds"):
        diagnose(load_case(case), config)


def test_a_run_that_stands_for_minutes_is_used_from_where_it_moves(case: Path) -> None:
    run = load_case(case).runs[0]
    still = np.concatenate([np.zeros(3000, int), np.arange(len(run.time))])
    time = np.concatenate([0.1 * np.arange(3000), 300 + run.time])
    long = replace(run.where(still), time=time)
    (cut,) = limited(load_case(case).with_runs((long,)), DiagnoseConfig(max_seconds=3.0)).runs
    first = np.argmax((run.command != run.command[0]).any(axis=1))
    assert cut.time[0] == 0
    moved = np.argmax((cut.command != cut.command[0]).any(axis=1))
    assert cut.time[moved] == pytest.approx(1.0, abs=0.11)
    np.testing.assert_array_equal(cut.signals["joint_pos"][moved], run.signals["joint_pos"][first])


@pytest.mark.parametrize("effect", ["camera_delay", "ground_friction"])
def test_effects_that_cannot_act_name_no_first_cause(made, effect: str) -> None:
    folder = made(Truth(coulomb={"elbow": 2.0}), runs=3, span=(1.5, 1.6))
    found = diagnose(load_case(folder), DiagnoseConfig(effects=(effect,), bootstrap=20, threads=1))
    assert found.verdict == "unexplained"
    assert found.causes == ()


@pytest.mark.parametrize(
    "wrong", [{"bootstrap": 0}, {"seed": -1}, {"max_seconds": 0.02}, {"max_seconds": float("nan")}, {"holdout": -1}]
)
def test_settings_that_would_fail_late_are_refused_at_once(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        DiagnoseConfig(**wrong)


def test_replicates_are_found(case: Path) -> None:
    repeated(case, "run_09", 1e-5)
    assert replicates(load_case(case)) == [[0, 4]]


def test_the_same_recording_twice_is_one_run(case: Path) -> None:
    """Else a run that is left out for the check could be one of those that were fitted."""
    repeated(case, "run_09", 0.0)
    loaded = load_case(case)
    assert "run_09" not in [r.name for r in loaded.runs]
    assert loaded.dropped_runs == ("run_09.npz: the same samples as run_01",)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a | {"joint_vel": a["joint_vel"].astype(str)}, "plain numbers"),
        (
            lambda a: a | {"joint_vel": np.where(a["time"][:, None] > 1, np.float64(1e300), a["joint_vel"])},
            "no robot has",
        ),
        (lambda a: a | {"command": np.where(a["time"][:, None] > 1, -1e9, a["command"])}, "no robot has"),
    ],
)
def test_values_that_are_damage_drop_their_run(case: Path, change: Callable, said: str) -> None:
    file = case / "runs" / "run_02.npz"
    np.savez(file, **change(dict(np.load(file))))
    (why,) = load_case(case).dropped_runs
    assert why.startswith("run_02.npz: ")
    assert said in why


def test_unknown_effect_gives_the_closest() -> None:
    with pytest.raises(UnknownNameError, match="coulomb_friction"):
        explain("coulomb")
