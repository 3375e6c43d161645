"""Laws of the environment: windows, mirror images, ends, resets, repeatability; on a double of the engine."""

from dataclasses import fields, replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the trainer needs torch (extra `train`)")

from tests.trainer.fakes import BoxCaster, FakePhysics, course, quadruped, walk  # noqa: E402
from trainer.errors import TrainerError  # noqa: E402
from trainer.tasks.parkour import ParkourConfig, ParkourEnv, check  # noqa: E402
from trainer.tasks.parkour.config import (  # noqa: E402
    CommandConfig,
    DepthConfig,
    ObservationConfig,
    RandomisationConfig,
    ResetConfig,
    TerminationConfig,
)
from trainer.tasks.parkour.depth import DepthWindow, crop, kept_pixels, normalise, rays  # noqa: E402
from trainer.tasks.parkour.footholds import EdgeIndex  # noqa: E402
from trainer.tasks.parkour.signals import gravity_in  # noqa: E402
from trainer.tasks.parkour.terminations import CAUSES, OUTCOMES  # noqa: E402
from trainer.tasks.parkour.variants import scaled, scaled_spec, sizes  # noqa: E402
from trainer.tasks.rotations import (  # noqa: E402
    about_z,
    from_vector,
    heading_of,
    into_heading,
    multiply,
    rotate,
    rotate_back,
    yaw_of,
)
from trainer.terrain.edges import feature_edges  # noqa: E402

QUIET = ParkourConfig(
    observation=ObservationConfig(noise=False),
    depth=DepthConfig(use=False, noise=0.0, dropout=0.0, latency=(0, 0), mount_position=0.0, mount_rotation=0.0),
    randomisation=RandomisationConfig(use=False),
    reset=ResetConfig(position=0.0, yaw=0.0, joints=0.0, spread_ages=False),
)


def env_of(config=QUIET, worlds=4, motion=None, seed=0, terrain=None, **options):
    terrain = terrain or course()
    terrains = [terrain] * options.pop("copies", 1)
    physics = FakePhysics(quadruped(), terrains, worlds, motion)
    edges = [feature_edges(t) for t in terrains]
    return ParkourEnv(physics, BoxCaster(terrains), edges, config, seed=seed, **options)


def still(env):
    return torch.zeros(env.num_worlds, env.num_actions)


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
    assert torch.allclose(yaw_of(about_z(angle)), angle, atol=1e-6)
    assert torch.allclose(heading_of(qa), torch.stack([yaw_of(qa).cos(), yaw_of(qa).sin()], -1), atol=1e-5)
    ahead = heading_of(about_z(angle))
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


# ---------------------------------------------------------------- depth


def test_the_rays_are_those_of_the_full_image_that_the_robot_keeps():
    mount = quadruped().camera
    rows, columns = kept_pixels(mount)
    assert len(rows) == 18
    assert len(columns) == 32
    # Against the pipeline itself: nearest pixel of the 64 x 36 grid, then the 32 x 18 pixels at the bottom centre.
    full = np.arange(270 * 480).reshape(270, 480)
    small = full[((np.arange(36) + 0.5) * 7.5).astype(int)][:, ((np.arange(64) + 0.5) * 7.5).astype(int)]
    assert np.array_equal(crop(full, mount), small[18:, 16:48])
    directions = rays(mount).reshape(18, 32, 3)
    focal = 135 / np.tan(np.radians(mount.fovy_deg) / 2)
    v, u = divmod(int(crop(full, mount)[5, 7]), 480)
    d = directions[5, 7]
    assert np.allclose([d[1] / d[0], d[2] / d[0]], [(240 - (u + 0.5)) / focal, (135 - (v + 0.5)) / focal])
    assert (directions[..., 2] < 0).all()  # the lower half looks down
    assert np.allclose(np.linalg.norm(directions, axis=-1), 1)


def test_the_strided_window_equals_naive_storing():
    config = DepthConfig(frames=4, stride=3, latency=(0, 2))
    rng = torch.Generator().manual_seed(0)
    window = DepthWindow(config, (2, 3), 5, torch.device("cpu"))
    everyone = torch.arange(5)
    first = torch.rand(5, 2, 3, generator=rng)
    window.restart(everyone, first, rng)
    seen = [[first[i]] for i in range(5)]
    for step in range(40):
        images = torch.rand(5, 2, 3, generator=rng)
        window.push(images)
        for i in range(5):
            seen[i].append(images[i])
        if step == 17:
            begin = torch.rand(2, 2, 3, generator=rng)
            window.restart(torch.tensor([1, 4]), begin, rng)
            seen[1], seen[4] = [begin[0]], [begin[1]]
        for i in range(5):
            late = int(window.late[i])
            naive = [seen[i][max(0, len(seen[i]) - 1 - late - 3 * k)] for k in range(4)]
            assert torch.equal(window.window()[i], torch.stack(naive))
    assert torch.equal(window.window(torch.tensor([3, 1])), window.window()[[3, 1]])


def test_every_frame_of_the_window_was_once_the_newest():
    """What a learner relies on that keeps each image once: frame k is the newest of k strides ago, or the first."""
    config = replace(
        ParkourConfig(),
        depth=DepthConfig(frames=3, stride=4, latency=(0, 2)),
        termination=TerminationConfig(seconds=0.6),
    )
    env = env_of(config, motion=walk(0.5))
    newest = [env.reset().depth[:, 0]]
    begin = [0] * 4
    for step in range(1, 50):
        result = env.step(still(env))
        for i in [] if env.ends is None else env.ends.ids.tolist():
            begin[i] = step
        depth = result.observation.depth
        newest.append(depth[:, 0])
        for i in range(4):
            for k in range(3):
                assert torch.equal(depth[i, k], newest[max(begin[i], step - 4 * k)][i])
    assert max(begin) > 0


def test_depth_is_along_the_axis_and_what_is_not_there_is_far():
    config = replace(QUIET, depth=replace(QUIET.depth, use=True, frames=2, stride=1, far=20.0))
    env = env_of(config, terrain=course(ground_fails=True))
    o = env.reset()
    assert o.depth.shape == (4, 2, 18, 32)
    assert env.layout.depth == (2, 18, 32)
    # The lowest rays pass the border of the start platform and meet the ground; a plane's depth is the same in a row.
    mount = quadruped().camera
    level = rotate(torch.tensor(mount.quat).float(), torch.tensor(rays(mount)).float()).view(18, 32, 3)
    height = env.physics.state.camera_pos[0, 2] + mount.pos[2] + 0.35
    along = height / -level[17, 16, 2] * torch.tensor(rays(mount)).float().view(18, 32, 3)[17, 16, 0]
    assert o.depth[0, 0, 17, 16].item() == pytest.approx(((along - 0.15) / (20 - 0.15)).item(), abs=1e-4)
    assert (o.depth[0, 0, 17, 14:18] - o.depth[0, 0, 17, 14]).abs().max() < 1e-5
    raw = torch.tensor([0.0, float("nan"), 0.1, 0.15, 10.075, 99.0])
    assert normalise(raw, config.depth).tolist() == pytest.approx([1, 1, 0, 0, 0.5, 1], abs=1e-6)


# ---------------------------------------------------------------- terrain under the feet


def test_edges_are_found_as_by_looking_at_all_of_them():
    rng = np.random.default_rng(0)
    terrains = [rng.uniform(-1, 1, (30, 2, 3)), np.zeros((0, 2, 3)), rng.uniform(0, 2, (7, 2, 3))]
    index = EdgeIndex(terrains, 0.05, torch.device("cpu"))
    ids = torch.tensor([0, 2, 1])
    # Points close to edges, some of which are beyond the border of the grid.
    points = np.zeros((3, 200, 3))
    for row, which in enumerate(ids.tolist()):
        edges = terrains[which]
        if len(edges):
            pick, t = rng.integers(0, len(edges), 200), rng.uniform(-0.1, 1.1, (200, 1))
            points[row] = edges[pick, 0] * (1 - t) + edges[pick, 1] * t + rng.normal(0, 0.03, (200, 3))
    found = index.depth(torch.tensor(points).float(), ids).numpy()
    for row, which in enumerate(ids.tolist()):
        expected = np.zeros(200)
        for a, b in terrains[which]:
            t = np.clip((points[row] - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)[:, None]
            distance = np.linalg.norm(points[row] - a - t * (b - a), axis=1)
            expected = np.maximum(expected, 0.05 - distance)
        assert np.allclose(found[row], expected, atol=1e-5)
    assert (found[0] > 0).any()


def test_the_footholds_of_a_standing_robot():
    env = env_of()
    env.reset()
    env.physics.state.foot_pos[0, 0, :2] = torch.tensor([0.44, 0.0])  # a foot 1 cm from the border of the platform
    env.physics.state.foot_pos[1, 0, :2] = torch.tensor([0.6, 0.0])  # and one over the abyss
    look = env.probe(env.physics.state, env.terrain_ids)
    assert torch.allclose(look.terrain_z[0], torch.zeros(4, 1), atol=1e-5)
    assert look.terrain_z[1, 0, 0].item() == pytest.approx(-0.35, abs=1e-5)
    height = float(env.physics.state.foot_pos[0, 0, 2] - env.body.sole_depth[0])
    assert look.clearance[0, 0, 0].item() == pytest.approx(height, abs=1e-5)
    assert look.edge_depth[0, 0, 0].item() == pytest.approx(0.05 - np.hypot(0.01, height), abs=1e-5)
    assert look.edge_depth[1, 0, 0] == 0


# ---------------------------------------------------------------- ends


def outcome(env):
    return [OUTCOMES[k] for k in env.ends.outcome.tolist()]


def until_an_end(env, limit=1100):
    for step in range(1, limit):
        result = env.step(still(env))
        if env.ends is not None:
            return step, result
    raise AssertionError("nothing ended")


def test_standing_at_the_start_ends_after_four_seconds():
    env = env_of(worlds=1)
    env.reset()
    step, result = until_an_end(env)
    assert outcome(env) == ["stuck"]
    assert step * env.policy_dt == pytest.approx(4.0, abs=0.05)
    assert result.terminated.all()
    assert not result.truncated.any()


def test_told_to_stand_nobody_is_stuck_and_time_runs_out():
    config = replace(QUIET, command=CommandConfig(standing=1.0), termination=TerminationConfig(seconds=5.0))
    env = env_of(config, worlds=1)
    env.reset()
    step, result = until_an_end(env)
    assert outcome(env) == ["timeout"]
    assert step == env.max_steps == 250
    assert result.truncated.all()


def test_arriving_and_staying_succeeds():
    def go(physics):
        if physics.state.base_pos[0, 0] < 3.0:
            walk(1.0)(physics)

    env = env_of(worlds=1, motion=go)
    env.reset()
    _, result = until_an_end(env)
    assert outcome(env) == ["success"]
    assert result.truncated.all()
    assert env.ends.covered.item() == pytest.approx(1.0, abs=0.02)
    assert env.ends.position[0, 0].item() == pytest.approx(3.0, abs=0.05)


def test_running_through_is_no_success():
    env = env_of(replace(QUIET, termination=TerminationConfig(seconds=4.0)), worlds=1, motion=walk(1.5))
    env.reset()
    until_an_end(env)
    assert "success" not in outcome(env)


@pytest.mark.parametrize(
    ("field", "row", "expected"),
    [("ground_contact", True, "ground"), ("diverged", True, "diverged"), ("torso_quat", (0.7, 0.714, 0, 0), "tilt")],
)
def test_failures(field, row, expected):
    env = env_of()
    env.reset()
    getattr(env.physics.state, field)[2] = torch.tensor(row)
    result = env.step(still(env))
    assert env.ends.ids.tolist() == [2]
    assert outcome(env) == [expected]
    assert result.terminated.tolist() == [False, False, True, False]
    assert set(CAUSES) < set(OUTCOMES)


def test_ground_may_be_touched_where_the_terrain_allows_but_not_lain_on():
    env = env_of(terrain=course(ground_fails=False))
    env.reset()
    env.physics.state.ground_contact[:] = True
    env.step(still(env))
    assert env.ends is None
    env.physics.state.base_pos[1, 2] = 0.05
    env.step(still(env))
    assert env.ends.ids.tolist() == [1]
    assert outcome(env) == ["collapsed"]


def test_the_final_observation_is_that_of_the_end_and_the_next_that_of_a_new_start():
    def drift(physics):
        physics.state.joint_vel += 1.0

    config = replace(QUIET, command=CommandConfig(standing=1.0), termination=TerminationConfig(seconds=1.0))
    config = replace(config, depth=replace(QUIET.depth, use=True, frames=2, stride=2))
    env = env_of(config, motion=drift)
    fresh = env.reset()
    env.age[:2] = 10  # two worlds end ten steps before the others
    _, result = until_an_end(env)
    assert result.truncated.tolist() == [True, True, False, False]
    last = result.final_observation
    # 40 steps in, joint speeds have been counted up to 40; a fresh start is at rest.
    velocity = slice(3 + 3 + 3 + 12, 3 + 3 + 3 + 24)
    assert (last.critic[:2, velocity] == 40).all()
    assert (result.observation.critic[:2, velocity] == 0).all()
    assert torch.equal(result.observation.actor[:2], fresh.actor[:2])
    assert torch.equal(result.observation.depth[:2], fresh.depth[:2])
    assert torch.equal(result.observation.critic[2:], last.critic[2:])
    assert env.age.tolist() == [0, 0, 40, 40]


def test_first_ages_are_spread():
    env = env_of(replace(QUIET, reset=ResetConfig(spread_ages=True)), worlds=64)
    env.reset()
    assert env.age.float().std() > 100


# ---------------------------------------------------------------- broken worlds


def test_a_broken_world_is_reset_and_counted_and_poisons_nothing():
    env = env_of(replace(QUIET, log_every=10, divergence_limit=0.5))
    env.reset()
    for name in ("base_pos", "joint_pos", "joint_vel", "foot_pos", "foot_lin_vel"):
        getattr(env.physics.state, name)[1] = float("nan")
    env.physics.state.diverged[1] = True
    result = env.step(still(env))
    for o in (result.observation, result.final_observation):
        assert o.actor.isfinite().all()
        assert o.critic.isfinite().all()
    assert result.reward.isfinite().all()
    env.physics.overflowed = 7
    logs = [env.step(still(env)).log for _ in range(9)]
    assert not any(logs[:-1])  # figures are fetched once an interval
    assert logs[-1]["physics/diverged"] == 1
    assert logs[-1]["physics/overflowed"] == 7
    assert [text.split()[0] for text in env.warnings] == ["7", "1"]


def test_too_many_broken_worlds_stop_the_training():
    def break_all(physics):
        physics.state.diverged[:] = True

    env = env_of(replace(QUIET, log_every=5), motion=break_all)
    env.reset()
    with pytest.raises(TrainerError, match="diverges too often"):
        for _ in range(5):
            env.step(still(env))


# ---------------------------------------------------------------- randomness


def test_the_same_seed_gives_the_same_run_and_another_another():
    def run(seed):
        env = env_of(ParkourConfig(), motion=walk(0.5), seed=seed)
        env.reset()
        return [env.step(torch.full((4, 12), 0.1)) for _ in range(20)]

    a, b, c = run(1), run(1), run(2)
    for x, y in zip(a, b, strict=True):
        assert torch.equal(x.observation.actor, y.observation.actor)
        assert torch.equal(x.observation.depth, y.observation.depth)
        assert torch.equal(x.reward, y.reward)
    assert not torch.equal(a[0].observation.actor, c[0].observation.actor)


def test_a_saved_state_continues_exactly():
    env = env_of(ParkourConfig(), copies=6, rows=3)
    env.reset()
    env.step(still(env))
    saved = env.state_dict()
    first = env.reset()
    other = env_of(ParkourConfig(), copies=6, rows=3, seed=99)
    other.load_state_dict(saved)
    second = other.reset()
    assert torch.equal(first.actor, second.actor)
    assert torch.equal(first.depth, second.depth)
    assert torch.equal(env.terrain_ids, other.terrain_ids)


def test_randomised_parameters_lie_in_their_ranges():
    env = env_of(replace(ParkourConfig(), depth=QUIET.depth), worlds=200)
    env.reset()
    _, params = env.physics.params[-1]
    c = env.config.randomisation
    for name, (low, high) in {"friction": c.friction, "mass_scale": c.mass, "kp_scale": c.kp, "kd_scale": c.kd}.items():
        drawn = getattr(params, name)
        assert drawn.min() >= low
        assert drawn.max() <= high
        assert drawn.std() > 0
    assert set(params.delay_steps.tolist()) == {0, 1, 2, 3, 4}
    assert all(getattr(params, f.name) is not None for f in fields(params))


def test_every_world_is_pushed_once_in_a_period():
    config = replace(QUIET, randomisation=RandomisationConfig(push_seconds=0.2))
    env = env_of(config, worlds=23)
    env.reset()
    for _ in range(10):
        env.step(still(env))
    pushed = torch.cat([ids for ids, _ in env.physics.pushed])
    assert sorted(pushed.tolist()) == list(range(23))
    assert max(v[:, :2].abs().max() for _, v in env.physics.pushed) <= 0.5


def test_style_transitions_do_not_span_a_reset():
    def count(physics):
        physics.state.joint_vel += 1.0

    env = env_of(replace(QUIET, amp=True), motion=count)
    env.reset()
    first = env.step(still(env)).amp
    width = env.step(still(env)).amp.shape[1] // 2
    env.age[0] = env.max_steps - 1
    result = env.step(still(env))
    speed = slice(9 + 12, 9 + 24)
    assert (first[:, :width][:, speed] == 0).all()
    assert (first[:, width:][:, speed] == 1).all()
    assert (result.amp[:, :width][:, speed] == 2).all()
    assert (result.amp[:, width:][:, speed] == 3).all()
    after = env.step(still(env)).amp
    assert after[0, :width][speed].tolist() == [0.0] * 12  # the start of the new episode
    assert after[1, :width][speed].tolist() == [3.0] * 12


# ---------------------------------------------------------------- terrains


def test_variants_are_scaled_courses():
    terrain = course()
    big = scaled(terrain, 1.1)
    assert np.allclose(big.goal.centre, [3.3, 0, 0])
    assert np.allclose(big.boxes[1].T[:3, 3], 1.1 * terrain.boxes[1].T[:3, 3])
    assert np.allclose(big.boxes[1].T[:3, :3], np.eye(3))
    assert big.floor_z == pytest.approx(-0.385)
    assert scaled(terrain, 1.0) is terrain
    assert sizes([terrain], RandomisationConfig()) == pytest.approx([0.95, 0.975, 1.0, 1.025, 1.05])
    assert sizes([terrain] * 200, RandomisationConfig()) == [1.0]
    assert sizes([terrain], RandomisationConfig(use=False)) == [1.0]


def test_a_scaled_scene_collides_where_its_mesh_is():
    import mujoco

    spec = mujoco.MjSpec()
    corners = np.array([[x, y, z] for x in (0, 0.4) for y in (0, 0.3) for z in (0, 0.2)])
    spec.add_mesh(name="part", uservert=corners.ravel())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="part", pos=[1.0, 0, 0])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.2, 0.3], pos=[0, 2.0, 0])
    reach = []
    for contact in (spec, scaled_spec(spec, 1.5)):
        model = contact.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        at = [np.array([3.0, 0.15, 0.1]) * (1 if contact is spec else 1.5), np.array([0, 9.0, 0])]
        to = [np.array([-1.0, 0, 0]), np.array([0, -1.0, 0])]
        geom = np.zeros(1, np.int32)
        hit = [p + d * mujoco.mj_ray(model, data, p, d, None, 1, -1, geom) for p, d in zip(at, to, strict=True)]
        reach.append((hit[0][0], hit[1][1]))
    assert reach[0] == pytest.approx((1.4, 2.2))
    assert reach[1] == pytest.approx((2.1, 3.3))


@pytest.mark.parametrize("ratio", [0.1, 100.0, float("nan")])
def test_a_wrong_scale_is_refused(ratio):
    with pytest.raises(TrainerError):
        check(scaled(course(), ratio))


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (CommandConfig, {"speed": (0.9, 0.5)}),
        (ObservationConfig, {"history": 0}),
        (DepthConfig, {"near": 3.0}),
        (TerminationConfig, {"seconds": 0.0}),
        (RandomisationConfig, {"kp": (0.0, 1.0)}),
    ],
)
def test_senseless_settings_are_refused(kind, values):
    with pytest.raises(TrainerError, match=kind.__name__):
        kind(**values)


def test_a_camera_is_needed_for_depth():
    physics = FakePhysics(replace(quadruped(), camera=None), [course()], 2)
    with pytest.raises(TrainerError, match="no depth camera"):
        ParkourEnv(physics, BoxCaster([course()]), [np.zeros((0, 2, 3))], ParkourConfig())
