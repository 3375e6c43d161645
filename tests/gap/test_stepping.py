"""Laws of the roll-outs that change the model as it moves."""

from functools import partial

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from realsim.gap.simulation.sampling import _clock, quiet_mujoco
from realsim.gap.simulation.stepping import Gear, rolled, spare, stepped, switched

SLED = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint name="x" type="slide" axis="1 0 0" solreffriction="0.0022 1"/><geom size="0.1" mass="2"/></body></worldbody>
<actuator><motor joint="x" gear="{gear}"/></actuator><sensor><jointpos joint="x"/></sensor></mujoco>"""
STEPS = 500


def sled(gear: float = 1.0) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SLED.format(gear=gear))


def rest(model: mujoco.MjModel) -> np.ndarray:
    return np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))


def test_without_a_law_it_is_the_plain_roll_out() -> None:
    model = sled()
    control = np.random.default_rng(0).normal(size=(STEPS, 1))
    _, theirs = rollout.rollout(model, mujoco.MjData(model), rest(model)[None], control[None])
    np.testing.assert_array_equal(stepped([], model, rest(model), control)[0], theirs[0])
    np.testing.assert_array_equal(rolled(model, rest(model), control)[0], theirs[0])


def test_a_second_run_of_a_model_begins_as_the_first_did() -> None:
    model = sled()
    control = np.random.default_rng(0).normal(size=(STEPS, 1))
    once = rolled(model, rest(model), control)[0]
    stepped([Gear(0, 0, 0.3)], model, rest(model), 2 * control)
    np.testing.assert_array_equal(rolled(model, rest(model), control)[0], once)


def test_no_clock_is_read_in_simulations_and_the_profiler_is_back_afterwards() -> None:
    model, before = sled(), _clock().value
    data, step = mujoco.MjData(model), mujoco.mjtTimer.mjTIMER_STEP
    with quiet_mujoco():
        mujoco.mj_step(model, data)
        assert data.timer[step].duration == 0
    assert _clock().value == before


@pytest.mark.parametrize("gear", [1.0, -3.0])
def test_what_is_left_of_the_drive_s_force_moves_the_sled(gear: float) -> None:
    model, ratio, force = sled(gear), 0.3, 4.0
    laws = [Gear(0, 0, ratio * abs(gear))]
    x = stepped(laws, model, rest(model), np.full((STEPS, 1), force))[0]
    time = STEPS * model.opt.timestep
    assert x[-1, 0] == pytest.approx(0.5 * (1 - ratio) * force * gear / 2 * time**2, rel=0.02)


def test_a_gear_that_locks_itself_stays() -> None:
    model = sled()
    x = stepped([Gear(0, 0, 1.2)], model, rest(model), np.full((STEPS, 1), 4.0))[0]
    assert np.abs(x).max() < 2e-3


def test_the_model_keeps_its_own_friction() -> None:
    model = sled()
    stepped([Gear(0, 0, 0.5)], model, rest(model), np.full((10, 1), 4.0))
    assert model.dof_frictionloss[0] == 0


def test_rows_after_an_explosion_are_no_numbers() -> None:
    model = sled()
    state = rest(model)
    state[1:3] = 9e9, 5e9  # it soon is beyond what MuJoCo takes for a position
    x = stepped([], model, state, np.zeros((STEPS, 1)))[0]
    bad = ~np.isfinite(x[:, 0])
    assert bad[-1]
    assert not bad[0]


ARM = """<mujoco><worldbody>{floor}<body pos="0 0 0.5"><joint name="a" axis="0 1 0" frictionloss="0.1"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="1" {kind}/><body pos="0.4 0 0"><joint axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="1" {kind}/></body></body>{other}</worldbody>
<actuator><motor joint="a" gear="5"/></actuator><sensor><jointpos joint="a"/><jointvel joint="a"/></sensor></mujoco>"""
FLOOR = '<geom type="plane" size="2 2 0.1"/>'
OTHER = '<body pos="0 2 2"><freejoint/><geom size="0.1"/></body>'
CONTACT, ISLAND = mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_ISLAND


@pytest.mark.parametrize(
    ("floor", "kind", "other", "spared"),
    [
        ("", 'contype="0" conaffinity="1"', "", CONTACT | ISLAND),
        (FLOOR, 'contype="0" conaffinity="0"', "", CONTACT | ISLAND),
        (FLOOR, "", "", ISLAND),
        (FLOOR, "", OTHER, 0),
    ],
)
def test_what_is_spared_changes_no_step(floor: str, kind: str, other: str, spared: int) -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(floor=floor, kind=kind, other=other))
    control = np.random.default_rng(0).normal(size=(STEPS, 1))
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    state[1 : 1 + model.nq] = model.qpos0
    before = rolled(model, state, control)[0]
    spare(model)
    assert model.opt.disableflags == spared
    np.testing.assert_array_equal(rolled(model, state, control)[0], before)


@pytest.mark.parametrize("step", [rolled, partial(stepped, [])])
def test_a_drive_that_is_switched_off_gives_no_force(step) -> None:
    """A servo lets go in the middle: before, as with it throughout; after, as one that was never there."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="j" axis="0 1 0" damping="0.1"/><geom size="0.1" pos="0.3 0 0"/></body>
        </worldbody><actuator><position joint="j" kp="50" kv="5"/></actuator>
        <sensor><jointpos joint="j"/><actuatorfrc actuator="a"/></sensor></mujoco>""".replace(
            "<position", '<position name="a"'
        )
    )
    control, off = np.full((STEPS, 1), 0.5), np.zeros((STEPS, 1), bool)
    off[STEPS // 2 :] = True
    x = switched(step, model, rest(model), control, off)
    on = step(model, rest(model), control)[0]
    np.testing.assert_array_equal(x[: STEPS // 2], on[: STEPS // 2])
    assert np.abs(x[STEPS // 2 + 1 :, 1]).max() == 0.0
    halfway = step(model, rest(model), control[: STEPS // 2])[1]
    model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0
    np.testing.assert_allclose(x[STEPS // 2 :], step(model, halfway, control[STEPS // 2 :])[0], atol=1e-9)
