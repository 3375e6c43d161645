"""Health: mistakes in units, order and sign are refused with what to write; the rest is measured and said."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from realsim.cli.command_line import main
from realsim.core.errors import GapError
from realsim.gap import Case, DiagnoseConfig, Run, load_case
from realsim.gap.case.health import examine, gathered
from realsim.gap.case.health.conventions import log_conventions
from realsim.gap.case.health.signals import beyond_range, spikes
from realsim.gap.pipeline import limited
from realsim.gap.simulation.simulate import Simulator
from tests.truths.written import write_case

from .truth import Truth

QUADRUPED = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="trunk" pos="0 0 .3"><freejoint/><geom type="box" size=".2 .1 .05" mass="5"/><site name="imu"/>
      <body name="leg" pos="0 0 -.05"><joint name="leg" axis="0 1 0"/>
        <geom type="box" size=".1 .08 .03" pos="0 0 -.1" mass="1"/></body>
    </body>
  </worldbody>
  <actuator><position name="leg_servo" joint="leg" kp="40" kv="2"/></actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def good(made: Callable[..., Path]) -> Case:
    return load_case(made(Truth(), torque="measured"))


def health(case: Case) -> dict[str, Any]:
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        return examine(simulator)


def spoiled(case: Case, change: Callable[[Run], Run]) -> Case:
    return case.with_runs(tuple(change(r) for r in case.runs))


def with_signal(name: str, change: Callable[[Any], Any]) -> Callable[[Run], Run]:
    return lambda run: replace(run, signals={**run.signals, name: change(run.signals[name].copy())})


def column(j: int, change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def apply(values: Any) -> Any:
        values[:, j] = change(values[:, j])
        return values

    return apply


def test_a_good_log_raises_no_alarm(good: Case) -> None:
    found = health(good)
    assert found["warnings"] == []
    # What the truth adds: 0.3 mrad of noise and a 0.4 mrad encoder step.
    assert 2e-4 < found["noise"]["joint_pos"]["sample"] < 6e-4
    assert found["quantum"]["joint_pos"] == pytest.approx(2 * np.pi / 16384, rel=0.05)
    assert found["clock"]["median_step_s"] == pytest.approx(1 / 125, rel=0.02)
    assert found["clock"]["jitter_s"] == pytest.approx(2.8e-4, rel=0.3)
    assert found["noise"]["joint_pos"]["replicates"] is None


def test_a_torque_that_its_servo_gives_is_not_odd_whatever_the_joint_meets(good: Case) -> None:
    kp, kv = good.model.actuator_gainprm[0, 0], -good.model.actuator_biasprm[0, 2]

    def moved(run: Run) -> Run:  # as if something else carried it and pushed it
        pos = run.signals["joint_pos"].copy()
        pos[:, 0] = run.command[:, 0] + 0.02 * np.sin(40 * run.time)
        vel = np.gradient(pos, run.time, axis=0)
        torque = kp * (run.command - pos) - kv * vel
        return replace(run, signals={**run.signals, "joint_pos": pos, "joint_vel": vel, "joint_torque": torque})

    case = good.with_runs(tuple(map(moved, good.runs)))
    assert not any("another course" in w for w in health(case)["warnings"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (with_signal("joint_pos", np.degrees), r"joint_pos of (shoulder|elbow) looks like deg[\s\S]*\"units\""),
        (lambda r: replace(r, command=np.degrees(r.command)), "command of (shoulder|elbow)_servo looks like deg"),
        (with_signal("joint_vel", column(1, np.degrees)), "joint_vel of elbow looks like deg/s"),
        (with_signal("joint_vel", lambda v: v * 30 / np.pi), "looks like rpm"),
        (with_signal("joint_torque", np.negative), r"joint_torque looks negated[\s\S]*\"sign\": -1"),
        (with_signal("joint_torque", lambda t: 1000 * t), r"joint_torque looks like mN m[\s\S]*\"units\""),
        (with_signal("joint_torque", lambda t: t / 0.0980665), "joint_torque looks like kgf cm"),
        (with_signal("joint_vel", column(0, np.negative)), "joint_vel of shoulder looks negated"),
        (with_signal("joint_pos", column(1, np.negative)), r"joint_(pos|vel) of elbow looks negated"),
        (lambda r: replace(r, signals={k: v[:, ::-1] for k, v in r.signals.items()}), "shoulder moves like elbow"),
        (lambda r: replace(r, time=50 * r.time), "too far apart"),
        (lambda r: replace(r, time=1e-3 * r.time), "too short"),
        (
            with_signal("joint_pos", lambda v: np.where(np.arange(len(v))[:, None] % 5, np.nan, v)),
            "most joint positions",
        ),
    ],
)
def test_plain_mistakes_are_refused(good: Case, change: Callable[[Run], Run], said: str) -> None:
    with pytest.raises(GapError, match=said):
        health(spoiled(good.with_runs(good.runs[:2]), change))


def hardly_moving(run: Run) -> Run:
    """Each joint's column goes a little as the other one's command, as play and stiction make it."""
    places = run.signals["joint_pos"]
    still = np.nanmean(places, axis=0)
    return replace(
        run,
        command=still + 0.02 * (run.command - still),
        signals={"joint_pos": still + 0.02 * (places - still)[:, ::-1]},
    )


def test_the_order_of_joints_that_hardly_move_is_not_doubted(good: Case) -> None:
    found = health(spoiled(good.with_runs(good.runs[:2]), hardly_moving))
    assert any("hardly moves" in w for w in found["warnings"])


def noise_about_rest(values: Any) -> Any:
    return values[:1] + np.random.default_rng(0).normal(0, 0.05, values.shape)


def test_positions_that_are_noise_are_refused(good: Case) -> None:
    with pytest.raises(GapError, match="more noise than motion"):
        health(spoiled(good, with_signal("joint_pos", noise_about_rest)))


def test_a_joint_that_does_not_move_is_said(good: Case) -> None:
    found = health(spoiled(good, with_signal("joint_pos", column(1, lambda p: noise_about_rest(p[:, None])[:, 0]))))
    assert any("more noise than motion: joint_pos of elbow" in w for w in found["warnings"])


def stands(values: Any) -> Any:
    return values[0] + np.random.default_rng(0).normal(0, 1e-4, values.shape)


def test_a_joint_that_is_commanded_and_stands_still_is_left_out(good: Case) -> None:
    config = DiagnoseConfig(threads=1)
    stuck = spoiled(good.with_runs(good.runs[:2]), with_signal("joint_pos", column(1, stands)))
    case = limited(stuck, config)
    assert case.joint_names == ("shoulder",)
    assert health(case)["warnings"][0].startswith("elbow: the reading stands still although the command moves")

    def held(run: Run) -> Run:
        return replace(run, command=np.column_stack([run.command[:, 0], np.full(len(run.time), run.command[0, 1])]))

    assert limited(spoiled(stuck, held), config).joint_names == good.joint_names  # nobody asked it to move
    with pytest.raises(GapError, match="no joint moves although"):
        limited(spoiled(stuck, with_signal("joint_pos", column(0, stands))), config)


def even(run: Run) -> Run:
    return replace(run, time=np.arange(len(run.time)) * 0.008)


def jittery(run: Run) -> Run:
    step = np.random.default_rng(0).exponential(0.008, len(run.time))
    return replace(run, time=np.cumsum(step) - step[0])


def gap_in_time(run: Run) -> Run:
    return replace(run, time=run.time + 0.3 * (np.arange(len(run.time)) > 100))


def another_course(torque: Any) -> Any:
    return 6 * torque + np.random.default_rng(0).normal(0, 30 * np.std(torque), torque.shape)


def held(values: Any) -> Any:
    return values[np.arange(len(values)) // 2 * 2]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (even, "perfectly even time stamps"),
        (jittery, "sampling step varies"),
        (gap_in_time, "1 late samples"),
        (with_signal("joint_pos", held), "the bus is slower than the log"),
        (with_signal("joint_torque", lambda t: np.clip(t, -3, 3)), "logged torque stays at 3"),
        (with_signal("joint_torque", column(0, np.negative)), "shoulder: torque looks negated"),
        (with_signal("joint_torque", column(0, lambda t: 30 * t)), r"shoulder: torque is [23]\d.* is it in N m"),
        (with_signal("joint_torque", column(0, another_course)), "shoulder: the logged torque has another course"),
        (lambda r: replace(r, init_qvel=np.ones(2)), "init_qvel is not zero"),
        (lambda r: replace(r, init_qpos=np.full(2, 2.0)), "init_qpos has"),
    ],
)
def test_what_is_odd_is_said(good: Case, change: Callable[[Run], Run], said: str) -> None:
    import re

    assert any(re.search(said, w) for w in health(spoiled(good, change))["warnings"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (with_signal("joint_vel", column(0, np.zeros_like)), "joint_vel of shoulder is not the slope"),
        (with_signal("joint_vel", column(1, np.negative)), "joint_vel of elbow is not the slope"),
        (lambda run: replace(run, command=-run.command), "the command of shoulder_servo looks negated"),
    ],
)
def test_a_run_that_is_unlike_the_others_is_said(good: Case, change: Callable[[Run], Run], said: str) -> None:
    first, *others = good.runs
    warnings = log_conventions(good.with_runs((change(first), *others)))
    assert any(w.startswith(f"{first.name}: {said}") for w in warnings)
    assert all(w.startswith(f"{first.name}: ") for w in warnings)


def test_runs_that_all_repeat_one_command_and_a_slow_log_are_said(good: Case) -> None:
    first = good.runs[0]
    again = replace(first, name="again", signals={k: v + 1e-4 for k, v in first.signals.items()})
    assert any("all runs repeat one command" in w for w in health(good.with_runs((first, again)))["warnings"])
    slow = spoiled(good, lambda run: run.where(np.arange(len(run.time)) % 12 == 0))
    assert any("what is faster" in w for w in health(slow)["warnings"])


def test_a_single_sample_far_from_those_around_it_is_said(good: Case) -> None:
    def zeroed(at: int) -> Callable[[Any], Any]:
        def change(values: Any) -> Any:
            values[at] = 0.0
            return values

        return column(1, change)

    assert not spikes(good)
    far = int(np.argmax(np.abs(good.runs[0].signals["joint_pos"][:, 1])))
    (said,) = spikes(spoiled(good.with_runs(good.runs[:1]), with_signal("joint_pos", zeroed(far))))
    assert said.startswith(f"{good.runs[0].name}: joint_pos of elbow at {good.runs[0].time[far]:.3f} s is far")
    step = column(1, lambda v: np.where(np.arange(len(v)) < far, 0.0, 1.0))
    assert not spikes(spoiled(good, with_signal("joint_pos", step)))  # what stays is no spike


def test_a_run_cut_out_of_motion_does_not_begin_at_rest(good: Case) -> None:
    cut = spoiled(good, lambda run: run.part(run.time > 1.1))
    assert any("does not begin at rest" in w for w in health(cut)["warnings"])


def test_a_start_elsewhere_is_said(good: Case) -> None:
    def jump(run: Run) -> Run:
        command = run.command.copy()
        command[:10, 0] += 0.5
        return replace(run, command=command)

    found = health(spoiled(good, jump))
    assert any("initial state does not match: shoulder" in w for w in found["warnings"])
    assert found["start"]["farthest_from_rest"] == pytest.approx(0.5, abs=0.1)


def test_the_same_warning_of_many_runs_is_one() -> None:
    runs = [f"run_{i}" for i in range(9)]
    said = gathered(["one thing", "run_0: late", *(f"run_{i}.csv: even" for i in range(1, 8)), "left out: run_9"], runs)
    assert said == ["one thing", "run_0: late", "run_1, run_2, run_3 and 4 more: even", "left out: run_9"]


def test_replicates_give_the_repeatability(good: Case) -> None:
    rng = np.random.default_rng(0)

    def noisy(values: Any) -> Any:
        return values + rng.normal(0, 0.002, values.shape)

    first = good.runs[0]
    twins = [replace(with_signal("joint_pos", noisy)(first), name=f"again_{i}") for i in range(3)]
    found = health(good.with_runs((first, *twins)))
    assert found["noise"]["joint_pos"]["replicates"] == pytest.approx(0.002, rel=0.35)


def floating_case(folder: Path, quat: list[float], height: float = 0.3, acc: float = 9.81) -> Case:
    t = np.arange(200) * 0.01 + 1e-4 * np.random.default_rng(0).random(200)
    q = 0.1 * np.sin(3 * t)[:, None]
    one = np.ones((200, 1))
    run = {"time": t, "command": q, "joint_pos": q, "base_pos": one * [0, 0, height], "base_quat": one * np.array(quat)}
    run |= {"imu_gyro": 0 * one * [1, 1, 1], "imu_acc": one * [0, 0, acc]}
    return load_case(write_case(folder, QUADRUPED, {"a": run}, imu_site="imu"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"quat": [0, 0, 0, 1], "height": 300.0}, "millimetres"),
        ({"quat": [0.707, 0.0, 0, 0.707], "acc": 1.0}, "looks like g"),
        ({"quat": [1.0, 0, 0, 0], "acc": -9.81}, "looks negated"),
        ({"quat": [0.1, 0.0, 0.0, 0.995]}, None),
        ({"quat": [0.0, 0.1, 0.1, 0.99]}, None),
    ],
)
def test_base_and_imu_conventions(tmp_path: Path, options: dict[str, Any], said: str | None) -> None:
    case = floating_case(tmp_path / "case", **options)
    if said:
        with pytest.raises(GapError, match=said):
            health(case)
    else:
        health(case)


def test_gravity_taken_out_is_said(tmp_path: Path) -> None:
    found = health(floating_case(tmp_path / "case", [1.0, 0, 0, 0], acc=0.05))
    assert any("gravity appears to have been removed" in w for w in found["warnings"])


def test_quaternion_in_another_order_is_refused(tmp_path: Path) -> None:
    tilted = floating_case(tmp_path / "case", [0.0, 0.0, 0.8, 0.6])
    with pytest.raises(GapError, match="x y z w"):
        health(tilted)


def test_what_is_logged_and_not_compared_is_said(good: Case, tmp_path: Path) -> None:
    def more(run: Run) -> Run:
        extra = {name: np.ones((len(run.time), 3)) for name in ("base_pos", "imu_gyro", "contact")}
        return replace(run, signals=run.signals | extra)

    said = health(replace(spoiled(good, more), torque_kind="none"))["warnings"]
    assert {w.split()[0] for w in said} == {"base_pos", "imu_gyro", "contact", "joint_torque"}
    assert next(w for w in said if "torque" in w).endswith("says none, not measured or current_times_constant")
    assert any("imu_gyro is not compared: log.json names no imu_site" in w for w in said)

    def without_place(run: Run) -> Run:
        touching = {"contact": np.ones((len(run.time), 1))}
        return replace(run, signals={k: v for k, v in run.signals.items() if k != "base_pos"} | touching)

    floating = floating_case(tmp_path / "case", [1.0, 0, 0, 0])
    said = health(replace(spoiled(floating, without_place), contact_bodies=("leg",)))["warnings"]
    assert [w for w in said if "compared" in w] == [
        "base_quat is neither compared nor taken for the pose that runs begin in: base_pos is not in every run"
    ]


def test_contacts_of_no_body_are_left_out_and_said(made: Callable[..., Path], tmp_path: Path) -> None:
    folder = shutil.copytree(made(Truth()), tmp_path / "case")
    for path in (folder / "runs").glob("*.npz"):
        with np.load(path) as data:
            np.savez(path, **data, contact=np.ones((len(data["time"]), 1)))
    case = load_case(folder)
    assert "run_01.npz: contact is left out: contact_bodies in log.json is empty" in case.warnings
    assert "contact" not in case.runs[0].signals


def test_nominal_that_falls_over_is_named(tmp_path: Path) -> None:
    case = floating_case(tmp_path / "case", [1.0, 0, 0, 0], height=1.0)
    with pytest.raises(GapError, match=r"falls over[\s\S]*in a at"):
        health(case)


def test_one_fall_of_the_nominal_among_many_runs_is_a_warning(tmp_path: Path) -> None:
    case = floating_case(tmp_path / "case", [1.0, 0, 0, 0])
    fallen = floating_case(tmp_path / "fallen", [1.0, 0, 0, 0], height=1.0).runs[0]
    stood = [replace(case.runs[0], name=name) for name in ("b", "c", "d")]
    said = health(case.with_runs((*stood, fallen)))["warnings"]
    assert any("falls over where the robot does not, in a at" in w for w in said)
    with pytest.raises(GapError, match="falls over"):
        health(case.with_runs((stood[0], fallen)))


def test_a_run_that_is_left_out_is_said_on_the_terminal(made: Callable[..., Path], tmp_path: Path, capsys: Any) -> None:
    case = shutil.copytree(made(Truth()), tmp_path / "case")
    sorted((case / "runs").iterdir())[0].write_bytes(b"torn")
    out = tmp_path / "out"
    assert main(["diagnose", str(case), "--out", str(out), "--effects", "command_delay", "--threads", "1",
                 "--no-report"]) == 0  # fmt: skip
    said = capsys.readouterr().out
    assert "about the log" in said
    warnings = json.loads((out / "diagnosis.json").read_text())["health"]["warnings"]
    assert any(w.startswith("left out: ") for w in warnings)
    assert str(out / "diagnosis.json") in said
    assert "report.html" not in said


def test_a_broken_case_stops_no_other(made: Callable[..., Path], tmp_path: Path, capsys: Any) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(made(Truth()), broken)
    (broken / "model.xml").write_text("<mujoco>")
    still = made(Truth(), runs=2, span=(1.0, 1.2))
    code = main(["diagnose", str(broken), str(still), "--out", str(tmp_path / "out"), "--jobs", "2", "--json",
                 "--effects", "command_delay", "--threads", "1", "--no-report"])  # fmt: skip
    said = json.loads(capsys.readouterr().out)
    assert code == 1
    assert [item["exit_code"] for item in said["items"]] == [2, 0]
    assert (tmp_path / "out" / still.name / "diagnosis.json").is_file()
    assert not (tmp_path / "out" / "broken").exists()


def test_encoders_that_come_up_late_are_borne(good: Case) -> None:
    def late(values: Any) -> Any:
        values[:6] = np.nan
        return values

    found = health(spoiled(good, with_signal("joint_pos", late)))
    assert found["warnings"] == []
    assert found["start"]["farthest_from_rest"] < 0.1


@pytest.mark.parametrize(("factor", "found"), [(1.0, 0), (65535 / 0.16, 1)])
def test_commands_in_another_unit_lie_beyond_the_range(tmp_path: Path, factor: float, found: int) -> None:
    t = np.arange(200) * 0.01
    thrust = 0.08 + 0.02 * np.sin(t)[:, None]
    pose = {"base_pos": np.ones((200, 1)) * [0, 0, 1.0], "base_quat": np.ones((200, 1)) * [1.0, 0, 0, 0]}
    xml = """
    <mujoco>
      <worldbody><body name="drone"><freejoint/><geom size=".05" mass=".03"/><site name="hub"/></body></worldbody>
      <actuator><motor name="m1" site="hub" gear="0 0 1 0 0 0" ctrllimited="true" ctrlrange="0 .16"/></actuator>
    </mujoco>"""
    run = {"time": t, "command": factor * thrust, "joint_pos": np.zeros((200, 0)), **pose}
    case = load_case(write_case(tmp_path, xml, {"a": run}, command_kind="torque"))
    notes = beyond_range(case)
    assert len(notes) == found
    assert all("m1: commanded beyond the model's range (0 to 0.16) in 100%" in note for note in notes)
