"""Laws of the roll-outs that change the model as it moves."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from realsim.gap.simulation.stepping import Gear, stepped

SLED = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint name="x" type="slide" axis="1 0 0" solreffriction="0.0022 1"/><geom size="0.1" mass="2"/></body></worldbody>
<actuator><motor joint="x" gear="{gear}"/></actuator><sensor><jointpos joint="x"/></sensor></mujoco>"""
STEPS = 500


def sled(gear: float = 1.0) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SLED.format(gear=gear))


def rest(model: mujoco.MjModel, runs: int) -> np.ndarray:
    return np.zeros((runs, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))


@pytest.mark.parametrize("threads", [1, 2])
def test_without_a_law_it_is_the_plain_roll_out(threads: int) -> None:
    model = sled()
    control = np.random.default_rng(0).normal(size=(3, STEPS, 1))
    ours = stepped(model, rest(model, 3), control, [], threads)
    _, theirs = rollout.rollout(model, mujoco.MjData(model), rest(model, 3), control)
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("gear", [1.0, -3.0])
def test_what_is_left_of_the_drive_s_force_moves_the_sled(gear: float) -> None:
    model, ratio, force = sled(gear), 0.3, 4.0
    laws = [Gear(0, 0, ratio * abs(gear))]
    (x,) = stepped(model, rest(model, 1), np.full((1, STEPS, 1), force), laws)
    time = STEPS * model.opt.timestep
    assert x[-1, 0] == pytest.approx(0.5 * (1 - ratio) * force * gear / 2 * time**2, rel=0.02)


def test_a_gear_that_locks_itself_stays() -> None:
    model = sled()
    (x,) = stepped(model, rest(model, 1), np.full((1, STEPS, 1), 4.0), [Gear(0, 0, 1.2)])
    assert np.abs(x).max() < 2e-3


def test_the_model_keeps_its_own_friction() -> None:
    model = sled()
    stepped(model, rest(model, 1), np.full((1, 10, 1), 4.0), [Gear(0, 0, 0.5)])
    assert model.dof_frictionloss[0] == 0


def test_rows_after_an_explosion_are_no_numbers() -> None:
    model = sled()
    state = rest(model, 1)
    state[0, 1:3] = 9e9, 5e9  # it soon is beyond what MuJoCo takes for a position
    (x,) = stepped(model, state, np.zeros((1, STEPS, 1)), [])
    bad = ~np.isfinite(x[:, 0])
    assert bad[-1]
    assert not bad[0]
