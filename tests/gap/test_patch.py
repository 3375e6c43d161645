"""A patch makes, in a plain spec and in model.xml, the simulator that was fitted; what it cannot hold, it says."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from realsim.core.errors import GapError, UnknownNameError
from realsim.core.files import to_json
from realsim.gap import EFFECTS, DiagnoseConfig, apply_patch, explain, load_case
from realsim.gap.answer.patch import asset_files, empty_patch, make_patch, patched_xml
from realsim.gap.simulation.simulate import Setting, Simulator
from tests.truths.written import write_case

from .truth import FINE, Truth

STANDING = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="step" pos="0 0 .02"><geom type="box" size=".3 .3 .02"/></body>
    <body name="trunk" pos="0 0 .33"><freejoint/><geom type="box" size=".15 .1 .05" mass="4"/><site name="imu"/>
      <body name="leg_l" pos="0 .08 -.05"><joint name="hip_l" axis="0 1 0" armature="0.01"/>
        <geom type="box" size=".08 .03 .12" pos="0 0 -.12" mass="1"/></body>
      <body name="leg_r" pos="0 -.08 -.05"><joint name="hip_r" axis="0 1 0" armature="0.01"/>
        <geom type="box" size=".08 .03 .12" pos="0 0 -.12" mass="1"/></body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip_l_servo" joint="hip_l" kp="60" kv="3" forcerange="-30 30"/>
    <position name="hip_r_servo" joint="hip_r" kp="60" kv="3" forcerange="-30 30"/>
  </actuator>
</mujoco>"""
CAMERA = {"camera_delay", "camera_mount", "depth_noise"}
WRAPPED = {"command_delay", "observation_delay", "joint_offset", "load_friction", "imu_bias", "position_torque"}


@pytest.fixture(scope="module")
def arm(made: Callable[..., Path]) -> Iterator[Simulator]:
    with Simulator(load_case(made(Truth(), FINE)), DiagnoseConfig(threads=1)) as found:
        yield found


@pytest.fixture(scope="module")
def walker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Simulator]:
    folder = tmp_path_factory.mktemp("standing")
    t = np.arange(150) * 0.01
    q, one = 0.1 * np.sin(4 * t)[:, None] * [1, 1], np.ones((150, 1))
    run = {"time": t, "command": q, "joint_pos": q, "base_pos": one * [0, 0, 0.33], "base_quat": one * [1, 0, 0, 0]}
    run |= {"imu_gyro": one * [0, 0, 0], "imu_acc": one * [0, 0, 9.81]}
    write_case(folder, STANDING, {"a": run}, imu_site="imu")
    with Simulator(load_case(folder), DiagnoseConfig(threads=1)) as found:
        yield found


@pytest.fixture(scope="module")
def flyer(hovering: Any) -> Iterator[Simulator]:
    with Simulator(hovering, DiagnoseConfig(threads=1)) as found:
        yield found


def fitted(simulator: Simulator, name: str) -> list[Setting]:
    """The effect at its first place, by one step of each of its parameters."""
    effect = EFFECTS[name]
    place = effect.places(simulator.context)[0]
    parameters = effect.parameters(simulator.context, place)
    values = {p.name: float(np.clip(p.default + p.step, *p.bounds)) for p in parameters if p.default < 1e5}
    values.pop("start", None)
    values.pop("reading_offset", None)  # of two kinds, the one that the servo reads
    return [(name, place, values)]


def moved(model: Any, case: Any, steps: int = 150) -> Any:
    """(steps, joints and centre of mass) of a motion under a common command; forces that need a control get it."""
    data = mujoco.MjData(model)
    path = []
    for k in range(steps):
        for name in case.actuator_names:
            data.ctrl[model.actuator(name).id] = 0.3 * np.sin(0.03 * k)
        mujoco.mj_step(model, data)
        path.append([*(data.qpos[model.joint(j).qposadr[0]] for j in case.joint_names), *data.subtree_com[0]])
    return np.array(path)


def robot(name: str, arm: Simulator, walker: Simulator, flyer: Simulator) -> Simulator:
    stands = name.startswith(("ground", "contact", "terrain"))
    those = [s for s in ([walker] if stands else [arm, walker, flyer]) if EFFECTS[name].places(s.context)]
    return those[0] if those else pytest.skip(f"none of these robots has a place of {name}")


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - CAMERA))
def test_round_trip(name: str, arm: Simulator, walker: Simulator, flyer: Simulator) -> None:
    """Through JSON, a plain spec and model.xml: the same motion as the simulator that was fitted."""
    simulator = robot(name, arm, walker, flyer)
    settings = fitted(simulator, name)
    patch = json.loads(to_json(make_patch(simulator, settings)))
    spec = mujoco.MjSpec.from_file(str(simulator.case.folder / "model.xml"))
    signals = apply_patch(spec, patch)
    ours = moved(spec.compile(), simulator.case)
    edit = simulator.edited(settings)
    reference = edit.spec.compile()
    if name == "external_force":  # the simulator turns it on by its control, the patch holds it
        reference.actuator(edit.signals.pulses[0].actuator).biasprm[0] = 1.0
        reference.actuator(edit.signals.pulses[0].actuator).biastype[0] = int(mujoco.mjtBias.mjBIAS_AFFINE)
    if name != "actuator_lag":  # the simulator lags the commands, the patch the activations: see test_lag
        np.testing.assert_allclose(ours, moved(reference, simulator.case), atol=1e-9)
    nominal = moved(simulator.case.model, simulator.case)
    if name != "load_friction":  # the model's own friction is made as stiff as what a wrapper adds to it
        assert (np.abs(ours - nominal).max() > 1e-6) == (name not in WRAPPED)
    assert bool(patch["wrappers"]) == (name in WRAPPED)
    assert patch["how"][0]["means"] == ("wrapper" if name in WRAPPED else "model")
    text = patched_xml(simulator, settings)
    loaded = mujoco.MjModel.from_xml_string(text)
    if name not in ("command_delay", "joint_offset"):  # these two are wrappers, but MJCF can hold them
        np.testing.assert_allclose(moved(loaded, simulator.case), ours, atol=2e-4)
        assert ("not in this file" in text) == (name in WRAPPED)
    else:
        assert "not in this file" not in text
        assert np.abs(moved(loaded, simulator.case) - nominal).max() > 1e-4
    assert signals.command_delay == edit.signals.command_delay
    assert ("wrapper" in explain(name)) == (name in WRAPPED)


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - CAMERA))
def test_what_comes_first_is_shared_and_not_changed(
    name: str, arm: Simulator, walker: Simulator, flyer: Simulator
) -> None:
    simulator = robot(name, arm, walker, flyer)
    settings, body = fitted(simulator, name), simulator.context.bodies[-1]
    beside: list[Setting] = [("payload", (body,), {"mass": 0.05, "x": 0.02}), ("command_delay", (), {"delay": 0.003})]
    beside += [("joint_offset", (joint,), {"offset": 0.01}) for joint in simulator.case.joint_names]
    for _ in range(2):
        found, at_once = simulator.simulate(settings, beside=beside), simulator.simulate([*beside, *settings])
        for one, other in zip(found, at_once, strict=True):
            np.testing.assert_array_equal(one, other)


def test_delay_in_the_xml_is_the_delay_of_the_simulator(arm: Simulator) -> None:
    steps = 6
    settings = [("command_delay", (), {"delay": steps * 0.002})]
    delayed = moved(mujoco.MjModel.from_xml_string(patched_xml(arm, settings)), arm.case)
    nominal = moved(arm.case.model, arm.case)
    assert np.abs(delayed[: steps + 2] - nominal[: steps + 2]).max() < 2e-3
    # The command starts at zero, so a delayed command is the same motion later; gravity alone moves it before.
    data = mujoco.MjData(arm.case.model)
    path = []
    for _ in range(20):
        mujoco.mj_step(arm.case.model, data)
        path.append([data.qpos[arm.case.model.joint(j).qposadr[0]] for j in arm.case.joint_names])
    free = np.array(path)
    np.testing.assert_allclose(delayed[:steps, :2], free[:steps], atol=1e-4)


def test_a_passing_force_stays_a_wrapper(arm: Simulator) -> None:
    values = {"fx": 3.0, "start": 0.5, "end": 1.0}
    settings = [("external_force", ("fore",), values)]
    patch = make_patch(arm, settings)
    assert patch["how"][0]["means"] == "wrapper"
    (force,) = patch["wrappers"]["external_force"]["value"]
    assert (force["start_s"], force["end_s"]) == (0.5, 1.0)
    spec = mujoco.MjSpec.from_file(str(arm.case.folder / "model.xml"))
    apply_patch(spec, patch)
    assert spec.compile().actuator(force["actuator"]).id >= 0
    assert "not in this file, see patch.wrappers in diagnosis.json: external_force" in patched_xml(arm, settings)


def test_an_empty_patch_changes_nothing(arm: Simulator) -> None:
    spec = mujoco.MjSpec.from_file(str(arm.case.folder / "model.xml"))
    before = spec.to_xml()
    assert empty_patch()["format"] == "realsim.gap.patch/2", "a name in files that people keep"
    apply_patch(spec, empty_patch())
    assert spec.to_xml() == before


def test_a_ratio_of_the_earlier_format_is_read(arm: Simulator) -> None:
    """It was the ratio less 1 and is its logarithm."""
    made = [
        {"format": f"realsim.gap.patch/{version}", "scales": {"torque_range": dict.fromkeys(arm.case.joint_names)},
         "settings": [{"effect": "stiffness_gain", "place": ["elbow"], "coordinates": {"ratio": ratio}}]}
        for version, ratio in ((1, -0.25), (2, np.log(0.75)))
    ]  # fmt: skip
    gains = []
    for patch in made:
        spec = mujoco.MjSpec.from_file(str(arm.case.folder / "model.xml"))
        apply_patch(spec, patch)
        gains.append(spec.compile().actuator(arm.context.actuator["elbow"]).gainprm[0])
    assert gains[0] == pytest.approx(gains[1])
    assert gains[0] == pytest.approx(0.75 * arm.case.model.actuator(arm.context.actuator["elbow"]).gainprm[0])


def test_foreign_patches_are_refused(arm: Simulator, walker: Simulator) -> None:
    patch = make_patch(arm, fitted(arm, "coulomb_friction"))
    spec = mujoco.MjSpec.from_file(str(walker.case.folder / "model.xml"))
    with pytest.raises(GapError, match=r"another model[\s\S]*shoulder"):
        apply_patch(spec, patch)
    with pytest.raises(GapError, match="not a patch"):
        apply_patch(spec, {"format": "other/1"})
    patch = make_patch(arm, fitted(arm, "payload"))
    patch["settings"][0]["place"] = ["foer"]
    with pytest.raises(UnknownNameError, match="did you mean fore"):
        apply_patch(mujoco.MjSpec.from_file(str(arm.case.folder / "model.xml")), patch)


def test_files_of_a_model_are_found(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    corners = "\n".join(f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    (tmp_path / "meshes" / "a.obj").write_text(corners + "\nf 1 2 3\nf 5 6 7\n")
    text = '<mujoco><compiler meshdir="meshes"/><asset><mesh name="a" file="a.obj"/></asset><worldbody/></mujoco>'
    (tmp_path / "model.xml").write_text(text)
    spec = mujoco.MjSpec.from_file(str(tmp_path / "model.xml"))
    assert asset_files(spec) == ["meshes/a.obj"]


def test_all_effects_can_be_listed() -> None:
    assert [line.split()[0] for line in explain("all").splitlines()] == list(EFFECTS)
