"""The depth window of the parkour task and the terrain under the feet."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.trainer.fakes import course, quadruped, walk
from tests.trainer.task_env import QUIET, env_of, still
from trainer.tasks.parkour import ParkourConfig
from trainer.tasks.parkour.config import (
    DepthConfig,
    TerminationConfig,
)
from trainer.tasks.parkour.depth import DepthWindow, crop, kept_pixels, normalise, rays
from trainer.tasks.parkour.footholds import EdgeIndex
from trainer.tasks.rotations import (
    rotate,
)

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
