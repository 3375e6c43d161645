"""Every reward term against a value worked out by hand, and the table against the paper."""

import math

import pytest
import torch

from realsim.core.errors import UnknownNameError
from tests.trainer.fakes import FakePhysics, course
from trainer.robots import ROBOTS
from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import RewardConfig
from trainer.tasks.parkour.rewards import TERMS, WEIGHTS, Rewards
from trainer.tasks.parkour.signals import Command, Footholds, derive

CONFIG = RewardConfig()


@pytest.fixture(scope="module")
def g1():
    return ROBOTS["g1"]()


@pytest.fixture
def body(g1):
    return Body.of(g1, "cpu")


@pytest.fixture
def s(g1):
    """Two worlds, standing still, told to go straight ahead at 0.8 m/s; feet flat on a floor at their soles."""
    state = FakePhysics(g1, [course()], 2).state
    state.foot_pos[:] = torch.tensor([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])
    feet, points = 2, len(g1.soles[0])
    depth = Body.of(g1, "cpu").sole_depth
    floor = (-depth).view(1, feet, 1).expand(2, feet, points).clone()
    nothing = torch.zeros(2, feet, points)
    return derive(
        state,
        Command(torch.tensor([[0.8, 0.0]] * 2), torch.zeros(2), torch.full((2,), 3.0), torch.full((2,), 0.8)),
        Footholds(floor, nothing.clone(), nothing.clone(), nothing.clone()),
        contact=torch.ones(2, feet, dtype=torch.bool),
        phase_time=torch.zeros(2, feet),
        action=torch.zeros(2, 29),
        last_action=torch.zeros(2, 29),
    )


def value(name, s, body):
    """The term in the second world; the first is left as it was and must not be touched."""
    return TERMS[name](s, body, CONFIG)[1].item()


def test_the_table_is_the_papers():
    # In the order of the appendix table; the AMP term belongs to the learner.
    paper = [
        2.0,
        0.1,
        -1.0,
        -0.5,
        3.0,
        -0.3,
        -1.0,
        0.5,
        -0.4,
        -0.5,
        -0.05,
        -1.5e-7,
        -1.25e-7,
        -1e-4,
        -0.005,
        -3.0,
        -3.0,
    ]
    paper += [-0.4, -0.1, 1.0, -5e-5, -0.004, -1.0, -1.0, -0.01, -1.0]
    assert list(WEIGHTS) == list(TERMS)
    assert list(WEIGHTS.values()) == paper


def test_velocity_tracking(s, body):
    s.heading_vel[1] = torch.tensor([0.5, 0.4])
    assert value("linear_velocity", s, body) == pytest.approx(math.exp(-(0.3**2 + 0.4**2) / 0.25))
    s.command.yaw_rate[1], s.ang_vel[1, 2] = 0.5, -0.1
    assert value("angular_velocity", s, body) == pytest.approx(math.exp(-(0.6**2) / 0.25))
    s.command.yaw_rate[1] = -0.7
    assert value("heading_error", s, body) == pytest.approx(0.7)


@pytest.mark.parametrize(("speed", "expected"), [(0.2, 0), (0.1, 1), (-0.1, 2), (-0.2, 3)])
def test_waiting(s, body, speed, expected):
    s.heading_vel[1, 0] = speed
    assert value("dont_wait", s, body) == expected
    s.command.velocity[1] = torch.tensor([0.2, 0.0])
    assert value("dont_wait", s, body) == 0


def test_alive_and_standing_still(s, body):
    assert value("alive", s, body) == 1
    s.state.joint_pos[1] = body.default
    s.state.joint_pos[1, :5] += 1.0
    assert value("stand_still", s, body) == 0  # told to go
    s.command.velocity[1] = 0.0
    assert value("stand_still", s, body) == pytest.approx(5.0 - 4.0, abs=1e-5)
    s.command.yaw_rate[1] = 0.2
    assert value("stand_still", s, body) == 0


def test_edges_cost_depth_times_speed(s, body):
    s.footholds.edge_depth[1, 0, :2] = torch.tensor([0.02, 0.01])
    s.footholds.speed[1, 0, :2] = torch.tensor([0.5, 0.0])
    epsilon = CONFIG.edge_epsilon
    assert value("edge_penetration", s, body) == pytest.approx(0.02 * (0.5 + epsilon) + 0.01 * epsilon)


def test_air_time_is_the_shorter_phase_on_one_leg(s, body):
    s.phase_time[1] = torch.tensor([0.3, 0.2])
    assert value("feet_air_time", s, body) == 0  # both feet down
    s.contact[1, 0] = False
    assert value("feet_air_time", s, body) == pytest.approx(0.2)
    s.phase_time[1] = 4.0
    assert value("feet_air_time", s, body) == pytest.approx(CONFIG.air_time_limit)
    s.command.velocity[1] = 0.0
    assert value("feet_air_time", s, body) == 0


def test_feet(s, body):
    s.state.foot_lin_vel[1, :] = torch.tensor([0.3, 0.4, 9.0])
    s.contact[1, 1] = False
    assert value("feet_slide", s, body) == pytest.approx(0.5)
    tilt = 0.2
    s.foot_gravity[1, :] = torch.tensor([math.sin(tilt), 0.0, -math.cos(tilt)])
    assert value("feet_orientation", s, body) == pytest.approx(math.sin(tilt))
    points = s.footholds.terrain_z.shape[-1]
    s.footholds.terrain_z[1, 0, 0] -= 0.1  # one point of the left sole hangs over a step of 10 cm
    s.footholds.terrain_z[1, 0, 1] -= 5.0  # one over an abyss: clipped to 0.3 m
    s.footholds.terrain_z[1, 1, :] -= 1.0  # the right foot is in the air and does not count
    assert value("feet_height", s, body) == pytest.approx(0.1 + 0.3, abs=1e-5)
    assert points >= 2
    s.foot_offset[1, :, 1] = torch.tensor([0.04, -0.03])
    assert value("feet_distance", s, body) == pytest.approx(math.exp(-0.05 / 0.05) - 1)
    s.foot_offset[1, :, 1] = torch.tensor([0.1, -0.1])
    assert value("feet_distance", s, body) == 0


def test_joints(s, body):
    s.state.joint_pos[1] = body.default
    s.state.joint_pos[1, body.hips] += 0.2
    assert value("hip_deviation", s, body) == pytest.approx(len(body.hips) * 0.04, rel=1e-4)
    s.state.joint_pos[1] = body.default
    s.state.joint_pos[1, body.upper_body[:3]] -= 0.1
    assert value("freeze_upper_body", s, body) == pytest.approx(0.3, rel=1e-4)
    s.state.joint_torque[1] = 2.0
    assert value("joint_torque", s, body) == pytest.approx(4.0 * len(body.legs))
    s.state.joint_acc[1] = 3.0
    assert value("joint_acceleration", s, body) == pytest.approx(9.0 * 29)
    s.state.joint_vel[1] = 0.5
    assert value("joint_velocity", s, body) == pytest.approx(0.25 * 29)
    assert value("energy", s, body) == pytest.approx(sum((1.0 / k) ** 2 for k in body.kp.tolist()), rel=1e-5)
    s.action[1, :2], s.last_action[1, :2] = 1.0, -1.0
    assert value("action_rate", s, body) == pytest.approx(8.0)


def test_uprightness(s, body):
    s.gravity[1] = torch.tensor([0.3, 0.4, -0.866])
    s.torso_gravity[1] = torch.tensor([0.1, 0.0, -0.995])
    s.ang_vel[1] = torch.tensor([1.0, 2.0, 7.0])
    assert value("base_orientation", s, body) == pytest.approx(0.25)
    assert value("torso_orientation", s, body) == pytest.approx(0.01)
    assert value("base_tumbling", s, body) == pytest.approx(5.0)


def test_safety(s, body):
    middle, half = (body.upper + body.lower) / 2, (body.upper - body.lower) / 2
    s.state.joint_pos[1] = middle + 0.89 * half  # within nine tenths of the range: free
    assert value("position_limits", s, body) == 0.0
    s.state.joint_pos[1, 0] = middle[0] + 0.9 * half[0] + 0.1
    s.state.joint_pos[1, 1] = middle[1] - 0.9 * half[1] - 0.2
    assert value("position_limits", s, body) == pytest.approx(0.3, rel=1e-4)
    s.state.joint_vel[1, 2] = -(0.9 * body.velocity[2] + 1.5)
    assert value("velocity_limits", s, body) == pytest.approx(1.5, rel=1e-4)
    s.state.joint_torque[1, 3] = -(0.8 * body.effort[3] + 2.0)
    assert value("torque_limits", s, body) == pytest.approx(4.0, rel=1e-4)
    s.state.other_contact[1] = True
    assert value("undesired_contact", s, body) == 1


def test_the_sum_is_weighted_times_the_step_and_spares_broken_worlds(s, body):
    only = RewardConfig(weights={name: 0.0 for name in TERMS if name not in ("alive", "undesired_contact")})
    s.state.other_contact[1] = True
    rewards = Rewards(only, body, 0.02, torch.device("cpu"))
    total, terms = rewards(s)
    assert total.tolist() == pytest.approx([3.0 * 0.02, (3.0 - 1.0) * 0.02])
    assert dict(zip(rewards.names, terms.tolist(), strict=True)) == pytest.approx(
        {"alive": 0.06, "undesired_contact": -0.01}
    )
    s.state.diverged[0] = True
    s.state.joint_pos[0] = float("nan")
    assert Rewards(CONFIG, body, 0.02, torch.device("cpu"))(s)[0].isfinite().all()


def test_a_wrong_name_is_refused(body):
    with pytest.raises(UnknownNameError, match="alive"):
        Rewards(RewardConfig(weights={"alife": 1.0}), body, 0.02, torch.device("cpu"))
