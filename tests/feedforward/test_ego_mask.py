"""What moves with the camera is found, left out and said; nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
import rooms
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim import feedforward
from realsim.core.types import Frame
from realsim.feedforward.config import PointsConfig
from realsim.feedforward.rgbd.ego_mask import describe_ego_mask, find_ego_mask, find_still_cells, mask_out
from realsim.feedforward.rgbd.features import prepare

POSES = rooms.path(16)
HAND = np.zeros((240, 320), bool)
HAND[150:, 40:130] = True


def holding(frame: Frame, where: np.ndarray = HAND, at: float = 0.4) -> Frame:
    """The frame with a hand before the camera, which has a texture of its own."""
    depth = np.where(where, np.float32(at), frame.depth())
    skin = (40 + 150 * rooms.texture(320, 3)[:240]).astype(np.uint8)[..., None]
    color = np.where(where[..., None], skin, frame.color())
    return replace(frame, read_depth=lambda: depth, read_color=lambda: color)


@pytest.fixture(scope="module")
def plain() -> list[Frame]:
    return [rooms.frame(k, T, posed=True) for k, T in enumerate(POSES)]


def test_nothing_is_carried_in_a_still_room(plain: list[Frame]) -> None:
    assert find_ego_mask(plain, POSES) is None


def test_wrong_poses_are_no_reason_to_leave_anything_out(plain: list[Frame]) -> None:
    assert find_ego_mask(plain, POSES[::-1]) is None
    assert find_ego_mask([holding(f) for f in plain], POSES[::-1]) is None


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 200), st.integers(0, 150), st.floats(0.3, 0.7))
def test_it_is_found_wherever_it_is(plain: list[Frame], left: int, top: int, at: float) -> None:
    where = np.zeros((240, 320), bool)
    where[top : top + 80, left : left + 90] = True
    cells = find_ego_mask([holding(f, where, at) for f in plain], POSES)
    assert cells is not None
    full = cells[np.arange(240)[:, None] * len(cells) // 240, np.arange(320) * cells.shape[1] // 320]
    assert full[where].mean() > 0.97
    assert (full & ~where).mean() < 0.1


def test_what_moves_by_itself_is_not_carried(plain: list[Frame]) -> None:
    moved = [holding(f, np.roll(HAND, (0, 12 * k), (0, 1)), 0.4 + 0.05 * (k % 5)) for k, f in enumerate(plain)]
    assert find_ego_mask(moved, POSES) is None


def test_features_that_stay_while_the_rest_moves_need_no_poses(plain: list[Frame]) -> None:
    assert find_still_cells(prepare(plain)) is None
    assert find_still_cells(prepare([plain[0]] * 8)) is None  # a camera that stands still
    assert find_still_cells(prepare(plain[:2])) is None
    cells = find_still_cells(prepare([holding(f) for f in plain]))
    assert cells is not None
    full = cells[np.arange(240)[:, None] * len(cells) // 240, np.arange(320) * cells.shape[1] // 320]
    assert full[HAND].mean() > 0.6
    assert (full & ~HAND).mean() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("poses", ["given", "estimate"])
def test_the_scene_is_made_without_it(plain: list[Frame], poses: str) -> None:
    frames = rooms.frame_set([holding(f) for f in plain[:7]])
    config = PointsConfig(poses=poses)
    solution = feedforward.solve(frames, config)
    assert "which moves with the camera" in solution.statistics["left_out"][0]
    maps = feedforward.pointmaps(frames, solution, config)
    assert not any(maps.load(i).mask[HAND].any() for i in range(len(maps)))
    steps = np.linalg.norm(np.diff(solution.T_world_camera[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps, np.linalg.norm(np.diff(POSES[:7, :3, 3], axis=0), axis=1), atol=0.01)


def test_it_is_said_where(plain: list[Frame]) -> None:
    cells = np.zeros((48, 64), bool)
    cells[36:, 16:32] = True
    assert "6% of every picture (25 to 50 % from the left, 75 to 100 % from the top)" in describe_ego_mask(cells)
    depth = mask_out(plain[0], cells).depth()
    assert not depth[180:, 80:160].any()
    np.testing.assert_array_equal(depth[:180], plain[0].depth()[:180])
