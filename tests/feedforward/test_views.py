"""Views from sensor depth: geometry, masks, confidence, colour on the depth grid."""

from dataclasses import replace

import numpy as np
import rooms

from realsim import feedforward
from realsim.core.geometry import exp_so3, make_T
from realsim.core.types import Frame, Intrinsics, Solution
from realsim.feedforward.config import PointsConfig
from realsim.feedforward.rgbd.views import point_view, resample

C = rooms.CAMERA


def plane(normal: np.ndarray, distance: float) -> np.ndarray:
    return (distance / (C.rays().astype(float) @ normal)).astype(np.float32)


def view_of(depth: np.ndarray, gain: float = 1.0, **more):  # type: ignore[no-untyped-def]
    return point_view(Frame("f", C, lambda: depth, **more), gain)


def test_points_are_gain_times_depth_along_the_rays() -> None:
    depth = plane(np.array([0, 0, 1.0]), 2.0)
    view = view_of(depth, 1.01)
    assert view.mask[5:-5, 5:-5].all()
    assert np.allclose(view.points[..., 2], 2.02)
    assert np.allclose(view.points[120, 160, 0], 2.02 * (160 - C.cx) / C.fx)


def test_flying_pixels_at_an_edge_are_masked_and_the_faces_are_not() -> None:
    depth = plane(np.array([0, 0, 1.0]), 3.0)
    depth[:, :160] = 1.2
    depth[:, 160] = 1.8  # blended by the sensor: in the air
    mask = view_of(depth).mask
    assert not mask[:, 160].any()
    assert mask[10:-10, 10:158].all()  # up to the two pixels beside the step: a top ends where it ends
    assert mask[10:-10, 163:-10].all()


def test_grazing_surfaces_are_masked_and_slanted_ones_are_not() -> None:
    def tilted(degrees: float) -> np.ndarray:
        depth = plane(exp_so3([np.radians(degrees), 0, 0]) @ np.array([0, 0, 1.0]), 1.0)
        return np.where((depth > 0.2) & (depth < 5), depth, 0).astype(np.float32)

    slanted, grazing = view_of(tilted(60)), view_of(tilted(86))
    assert slanted.mask[slanted.points[..., 2] > 0][1000:-1000].mean() > 0.97
    middle = np.s_[115:125, 155:165]
    assert not grazing.mask[middle].any()


def test_confidence_falls_with_range_and_follows_the_sensor() -> None:
    near, far = (view_of(plane(np.array([0, 0, 1.0]), d)).confidence[120, 160] for d in (1.0, 3.0))
    assert near > 2 * far > 0
    half = view_of(plane(np.array([0, 0, 1.0]), 1.0), read_confidence=lambda: np.full((240, 320), 0.5, np.float32))
    assert np.isclose(half.confidence[120, 160], near / 2)


def test_invalid_depth_holds_no_point() -> None:
    depth = plane(np.array([0, 0, 1.0]), 2.0)
    depth[50:60, 50:60], depth[70, 70], depth[71, 71] = 0, np.nan, np.inf
    view = view_of(depth)
    assert not view.mask[50:60, 50:60].any()
    assert not view.mask[70, 70]
    assert np.isfinite(view.points).all()
    assert (view.confidence[~view.mask] == 0).all()


def test_colour_of_another_size_lands_on_the_depth_grid() -> None:
    """A picture of the ray direction itself says after resampling which ray each depth pixel has."""
    big = Intrinsics(960, 540, 700.0, 690.0, 470.0, 280.0)
    picture = np.clip(127 + 200 * big.rays(), 0, 255).astype(np.uint8)
    got = resample(picture, big, C).astype(float)[60:180, 80:240]
    assert np.abs(got - np.clip(127 + 200 * C.rays(), 0, 255)[60:180, 80:240])[..., :2].max() < 3


def test_a_solution_makes_its_views_again() -> None:
    frames = [rooms.frame(k, T) for k, T in enumerate(rooms.path(3))]
    solution = Solution((0, 2), np.stack([np.eye(4), make_T(None, [1, 0, 0])]), True, depth_gain=1.02)
    maps = feedforward.pointmaps(rooms.frame_set(frames), solution, PointsConfig())
    assert [f.name for f in maps.frames] == ["000", "002"]
    view = maps.load(1)
    assert np.allclose(view.points[view.mask][:, 2], 1.02 * frames[2].depth()[view.mask], rtol=1e-5)
    assert view.color is not None
    assert replace(maps, backend="x").depth_gain == 1.02
