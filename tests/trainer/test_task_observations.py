"""What actor and critic of the parkour task are told, and that a mirrored world tells the mirror image."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.trainer.fakes import quadruped
from tests.trainer.task_env import QUIET, env_of, still
from trainer.tasks.parkour.config import (
    ObservationConfig,
)
from trainer.tasks.parkour.signals import gravity_in
from trainer.tasks.rotations import (
    about_z,
    from_vector,
    heading_of,
    into_heading,
    multiply,
    rotate,
    rotate_back,
)

# ---------------------------------------------------------------- rotations


def test_rotations_compose_and_invert():
    rng = torch.Generator().manual_seed(0)
    a, b, v = (torch.randn(9, 3, generator=rng) for _ in range(3))
    qa, qb = from_vector(a), from_vector(b)
    assert torch.allclose(rotate(multiply(qa, qb), v), rotate(qa, rotate(qb, v)), atol=1e-5)
    assert torch.allclose(rotate_back(qa, rotate(qa, v)), v, atol=1e-5)
    assert torch.allclose(rotate(qa, v).norm(dim=-1), v.norm(dim=-1), atol=1e-5)
    assert torch.allclose(gravity_in(qa), rotate_back(qa, torch.tensor([0.0, 0.0, -1.0])), atol=1e-6)
    angle = torch.tensor([-3.0, 0.0, 1.2])
    ahead = heading_of(about_z(angle))
    assert torch.allclose(ahead, torch.stack([angle.cos(), angle.sin()], -1), atol=1e-6)
    tilted = rotate(qa, torch.tensor([1.0, 0.0, 0.0]).expand(len(qa), 3))[:, :2]
    assert torch.allclose(heading_of(qa), tilted / tilted.norm(dim=-1, keepdim=True), atol=1e-5)
    assert torch.allclose(into_heading(ahead, ahead), torch.tensor([1.0, 0.0]).expand(3, 2), atol=1e-6)


# ---------------------------------------------------------------- observations


def test_the_history_holds_the_last_eight_measurements_oldest_first():
    def count(physics):
        physics.state.joint_vel += 1.0

    env = env_of(motion=count)
    first = env.reset()
    widths = [w for _, w in env.layout.actor]
    assert first.actor.shape[1] == sum(widths) == env.layout.actor_width
    names = [n for n, _ in env.layout.actor]
    assert names == ["base_ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_action"]

    def velocities(o):
        return o.actor.split(widths, -1)[4].view(4, 8, 12)

    assert (velocities(first) == 0).all()
    for step in range(1, 12):
        seen = velocities(env.step(still(env)).observation)[0, :, 0].tolist()
        assert seen == [max(0.0, step - 7.0 + k) for k in range(8)]


def test_the_last_action_is_seen_and_sent():
    env = env_of()
    env.reset()
    action = torch.linspace(-1, 1, 12).repeat(4, 1)
    seen = env.step(action).observation.actor[:, -12:]
    assert torch.equal(seen, action)
    assert torch.allclose(env.physics.targets, env.body.default + env.body.action_scale * action)


def test_the_actor_is_told_a_speed_and_the_critic_the_direction():
    env = env_of()
    env.reset()
    env.physics.state.base_quat[:] = about_z(torch.tensor([0.0, 0.5, -0.5, 0.0]))
    o = env.step(still(env)).observation
    told = o.actor.split([w for _, w in env.layout.actor], -1)[2].view(4, 8, 3)[:, -1]
    assert torch.allclose(told, torch.tensor([0.8, 0.0, 0.0]).expand(4, 3), atol=1e-6)
    critic = dict(
        zip([n for n, _ in env.layout.critic], o.critic.split([w for _, w in env.layout.critic], -1), strict=True)
    )
    assert torch.allclose(
        critic["target_velocity"][1], 0.8 * torch.tensor([np.cos(0.5), -np.sin(0.5)]).float(), atol=1e-5
    )
    assert critic["target_yaw_rate"][1].item() == pytest.approx(-0.5, abs=1e-5)
    assert critic["goal"].norm(dim=-1).tolist() == pytest.approx([3.0] * 4, abs=1e-4)


def test_a_steered_actor_is_told_the_direction_too():
    env = env_of(replace(QUIET, observation=ObservationConfig(noise=False, steered=True)))
    env.reset()
    env.physics.state.base_quat[:] = about_z(torch.tensor([0.0, 0.5, -0.5, 0.0]))
    o = env.step(still(env)).observation
    assert [n for n, _ in env.layout.actor][2] == "steering_command"
    told = o.actor.split([w for _, w in env.layout.actor], -1)[2].view(4, 8, 3)[:, -1]
    ahead, left = 0.8 * np.cos(0.5), -0.8 * np.sin(0.5)
    wanted = torch.tensor([[0.8, 0, 0], [ahead, left, -0.5], [ahead, -left, 0.5], [0.8, 0, 0]]).float()
    assert torch.allclose(told, wanted, atol=1e-5)


def test_noise_spoils_the_actor_only_and_stays_in_its_history():
    env = env_of(replace(QUIET, observation=ObservationConfig()))
    env.reset()
    a = env.step(still(env)).observation
    b = env.step(still(env)).observation
    assert not torch.equal(a.actor[0], a.actor[1])
    assert torch.equal(a.critic[0], a.critic[1])
    widths = [w for _, w in env.layout.actor]
    before, after = (o.actor.split(widths, -1)[3].view(4, 8, 12) for o in (a, b))
    assert torch.equal(before[:, 1:], after[:, :-1])


def test_a_mirrored_world_gives_the_mirrored_observation():
    """Reflect the whole state about the course's plane: what is seen must be `Mirror` of what was seen."""
    robot = quadruped()
    index, sign = torch.tensor(robot.mirror[0]), torch.tensor(robot.mirror[1])
    rng = torch.Generator().manual_seed(3)
    polar, axial = torch.tensor([1.0, -1, 1]), torch.tensor([-1.0, 1, -1])
    swap = [1, 0, 3, 2]

    def scatter(physics):
        s = physics.state
        s.base_pos[:] += 0.1 * torch.randn(s.base_pos.shape, generator=rng)
        s.base_quat[:] = from_vector(0.2 * torch.randn(4, 3, generator=rng))
        s.torso_quat[:] = s.base_quat
        s.base_lin_vel[:] = torch.randn(4, 3, generator=rng)
        s.base_ang_vel[:] = torch.randn(4, 3, generator=rng)
        s.joint_pos[:] += 0.2 * torch.randn(s.joint_pos.shape, generator=rng)
        s.joint_vel[:] = torch.randn(s.joint_vel.shape, generator=rng)
        s.foot_pos[:] += 0.05 * torch.randn(s.foot_pos.shape, generator=rng)
        s.foot_force[:] = torch.rand(s.foot_force.shape, generator=rng) * 2

    def reflect(physics):
        s, o = physics.state, one.physics.state
        for name in ("base_pos", "base_lin_vel"):
            getattr(s, name)[:] = getattr(o, name) * polar
        for name in ("base_quat", "torso_quat"):
            q = getattr(o, name)
            getattr(s, name)[:] = torch.cat([q[:, :1], q[:, 1:] * axial], -1)
        s.base_ang_vel[:] = o.base_ang_vel * axial
        s.joint_pos[:], s.joint_vel[:] = o.joint_pos[:, index] * sign, o.joint_vel[:, index] * sign
        s.foot_pos[:], s.foot_force[:] = o.foot_pos[:, swap] * polar, o.foot_force[:, swap]

    one, other = env_of(motion=scatter), env_of(motion=reflect)
    one.reset(), other.reset()
    for _ in range(3):
        action = torch.randn(4, 12, generator=rng)
        a = one.step(action)
        b = other.step(action[:, index] * sign)
        assert not (a.terminated | a.truncated).any()
        mirrored = one.mirror.observation(a.observation)
        assert torch.allclose(mirrored.actor, b.observation.actor, atol=1e-5)
        assert torch.allclose(mirrored.critic, b.observation.critic, atol=1e-4)
        assert torch.allclose(a.reward, b.reward, atol=1e-4)
    twice = one.mirror.observation(one.mirror.observation(a.observation))
    assert torch.equal(twice.actor, a.observation.actor)
    assert torch.equal(one.mirror.action(one.mirror.action(action)), action)
