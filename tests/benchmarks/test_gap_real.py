"""The check on real logs: its labels are exact, its splits fair, its tests of significance right."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.diagnosis.hardware.bench import Bench, Ruler, Starts, _like, fit, parted, predict, with_error, write
from benchmarks.diagnosis.hardware.errors import errors
from benchmarks.diagnosis.hardware.logs import LOGS, PENDULUM, windows, windows_of
from benchmarks.diagnosis.real import SHARES, _class, accepted_sets, figures, reliability, row
from realsim.gap import load_case
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects import EFFECTS
from realsim.gap.simulation.simulate import Simulator
from tests.truths.written import write_case

ARM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="upper" pos="0 0 1">
<joint name="shoulder" axis="0 1 0" damping="0.2" frictionloss="0.3" armature="0.02"/>
<inertial pos="0 0 -0.15" mass="1.5" diaginertia="0.01 0.01 0.002"/><body name="lower" pos="0 0 -0.3">
<joint name="elbow" axis="0 1 0" damping="0.2" frictionloss="0.3" armature="0.02"/>
<inertial pos="0 0 -0.12" mass="0.8" diaginertia="0.004 0.004 0.001"/></body></body></worldbody>
<actuator><position name="a" joint="shoulder" kp="60" kv="3"/><position name="b" joint="elbow" kp="40" kv="2"/>
</actuator></mujoco>"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """A log that its own model made: what is wrong later is only what is put in."""
    time, runs = np.arange(0.0, 8.0, 0.01), {}
    for name, rate in (("slow", 2.0), ("fast", 5.0)):
        command = np.column_stack([0.6 * np.sin(rate * time), 0.5 * np.sin(1.3 * rate * time + 1)])
        runs |= windows_of(name, {"time": time, "command": command, "joint_pos": command})
    return Bench(write_case(tmp_path_factory.mktemp("bench") / "case", ARM, runs))


def test_windows_share_a_run_and_begin_at_0() -> None:
    time = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.015, 1000))
    parts = windows({"time": time, "joint_pos": time[:, None]}, 3.0)
    assert len(parts) == 3
    assert all(p["time"][0] == 0 for p in parts)
    np.testing.assert_array_equal(np.concatenate([p["joint_pos"][:, 0] for p in parts]), time)


def test_no_window_is_both_fitted_and_diagnosed(bench: Bench) -> None:
    fitted, others = ({r.name for r in c.runs} for c in (bench.fitted, bench.others))
    assert not fitted & others
    assert fitted | others == {r.name for r in bench.case.runs}
    assert {n.rpartition("_")[0] for n in fitted} == {n.rpartition("_")[0] for n in others} == {"slow", "fast"}


def test_the_diagnosis_s_own_effect_with_the_label_s_value_mends_every_error(bench: Bench) -> None:
    """Two descriptions that share no code: an error in the model, and the effect that should undo it."""
    case = bench.others
    truth = predict(case)
    seen = set()
    for error in errors(bench.robot(case)):
        if error.shifts or not error.drawn or error.kind == "torque_limit":
            continue
        size = 0.6 * error.high if not error.either or -0.6 * error.high < error.least else -0.6 * error.high
        label = error.label(size)
        effect, place = EFFECTS[label["effect"]], tuple(label["joints"] or label["bodies"])
        value = label["parameters"][0]
        with Simulator(with_error(case, [(error, size)]), DiagnoseConfig(threads=1)) as simulator:
            wrong = simulator.simulate()
            known = {p.name: p for p in effect.parameters(simulator.context, place)}
            name = value["name"].removeprefix("d") if value["name"] not in known else value["name"]
            ratio = value["unit"] == "ratio" and label["effect"] != "load_friction"
            z = {name: np.log(value["value"]) if ratio else value["value"]}
            if label["effect"] == "payload":
                z |= dict(zip("xyz", case.model.body(place[0]).ipos.tolist(), strict=True))
            mended = simulator.simulate([(label["effect"], place, z)])
        # The start is estimated from the log under either model, and is not what is compared.
        late = [run.time > 0.5 for run in case.runs]
        away, left = (
            max(float(np.abs(a - b)[t].max()) for a, b, t in zip(truth, y, late, strict=True)) for y in (wrong, mended)
        )
        # Friction that the diagnosis adds is stiffer than MuJoCo's default, as a gear's is.
        share = 0.3 if error.kind == "coulomb_friction" else 0.12
        assert left < share * away + 2e-4, (error.kind, error.place, away, left)
        seen.add(error.kind)
    assert {"stiffness_gain", "coulomb_friction", "armature", "joint_offset", "payload", "link_geometry"} <= seen


def test_a_pendulum_that_only_torque_drives_is_fitted_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Near the top a replay of the whole would say more of its first state than of the model."""
    monkeypatch.setattr("benchmarks.diagnosis.hardware.bench.LATEST", 0)
    monkeypatch.setattr("benchmarks.diagnosis.hardware.bench.EVALUATIONS", 6)
    model = mujoco.MjModel.from_xml_string(PENDULUM.replace('damping="0.01"', 'damping="0.08"'))
    rng, time = np.random.default_rng(0), np.arange(0.0, 4.0, 0.01)
    data, seen, command = mujoco.MjData(model), [], 2 * np.sin(4 * time)[:, None]
    data.qpos[0] = 3.0
    for data.ctrl[0] in command[:, 0]:
        seen.append(data.qpos.copy())
        mujoco.mj_step(model, data, 5)
    noisy = np.array(seen) + rng.normal(0, 1e-3, (len(time), 1))
    runs = windows_of("one", {"time": time, "command": command, "joint_pos": noisy}, 1.0)
    bench = Bench(write_case(tmp_path / "case", PENDULUM, runs, command_kind="torque"))
    parts = parted(bench.others)
    assert len(parts.runs) == 2 * len(bench.others.runs)
    assert max(r.duration for r in parts.runs) < 0.55
    (left,) = fit(bench).left.values()
    assert left["unseen"] < 0.01 < 1.0 < left["motion"]


def test_late_commands_and_late_readings_are_alike_and_a_mass_is_not(bench: Bench) -> None:
    case = bench.others
    kinds = ("command_delay", "observation_delay", "payload", "armature")
    known = [e for e in errors(bench.robot(case)) if e.kind in kinds]
    delay = next(e for e in known if e.kind == "command_delay")
    base = predict(case)
    left = np.full(base[0].shape[1], 1e-3)
    ruler = Ruler(case, base, Starts.of(case, (), base, left), left)
    likes = {label["effect"] for label in _like(ruler, known, delay, ruler.change(predict(case, [(delay, 0.03)])))}
    assert "observation_delay" in likes
    assert "payload" not in likes


def test_a_written_case_is_read_back_with_its_error(bench: Bench, tmp_path: Path) -> None:
    error = next(e for e in errors(bench.robot(bench.others)) if (e.kind, e.place) == ("stiffness_gain", "elbow"))
    write(with_error(bench.others, [(error, 0.4)]), tmp_path / "case")
    case = load_case(tmp_path / "case")
    assert case.model.actuator("b").gainprm[0] == pytest.approx(40 * np.exp(0.4), rel=1e-6)
    assert [r.name for r in case.runs] == [r.name for r in bench.others.runs]


def test_real_logs_become_cases(shared: Callable[[str], Path], tmp_path: Path) -> None:
    assert {log.part for log in LOGS.values()} == {"development", "report"}
    for name in ("servo", "leg_FL"):
        found = Bench(LOGS[name].make(shared("real_logs"), tmp_path / name))
        assert len(found.others.runs) >= 4
    assert any(r.enabled is not None for r in load_case(tmp_path / "servo").runs)


def test_classes_have_their_shares() -> None:
    drawn = [_class(i, 20) for i in range(20)]
    assert {c: drawn.count(c) / 20 for c in SHARES} == pytest.approx(SHARES)


def test_figures_of_hand_made_rows() -> None:
    friction = {"effect": "coulomb_friction", "joints": ["j"], "parameters": []}
    gain = {"effect": "motor_gain", "joints": ["j"], "parameters": []}
    single = {
        "log": "x",
        "part": "report",
        "cls": "single",
        "effects": [friction],
        "alike": [[gain]],
        "visibility": [2],
    }
    none = single | {"cls": "none", "effects": [], "alike": [], "visibility": []}

    def said(verdict: str, *causes: dict, sure: float = 0.9) -> dict:
        named = [c | {"probability": sure} for c in causes]
        return {"verdict": verdict, "causes": named, "equivalent": [], "provenance": {"engine": "e"}}

    other = {"effect": "armature", "joints": ["j"]}
    rows = [
        row("a", single, said("identified", friction)),
        row("b", single, said("identified", gain)),
        row("c", single, said("identified", other, sure=0.7)),
        row("d", single, said("unexplained", friction)),
        row("e", none, said("no_gap")),
        row("f", none, said("unexplained")),
        row("g", none, said("identified", other)),
    ]
    found = figures(rows)
    assert found["confident_and_wrong"] == [1, 4]
    assert found["first_right"] == [2, 4]
    assert found["first_right_whatever_the_verdict"] == [3, 4]
    assert found["nothing_put_in_nothing_named"] == [2, 3]
    assert reliability(rows)["0.6 to 0.8"] == [0.7, 0.0, 1]
    assert accepted_sets(single) == [[friction], [gain]]
