"""Generated scenes: rays hit what stands there, all views show one world, and a seed is a batch."""

import numpy as np
import pytest
import torch

from realsim.core.errors import RealsimError
from training.pointmap import cameras, rays, sensor
from training.pointmap.draw import Draw
from training.pointmap.layouts import LAYOUTS, SLOTS, library
from training.pointmap.scenes import Batch, Generator

SIZE = (48, 64)
BOX, CYLINDER, BALL = 0, SLOTS["box"], SLOTS["box"] + SLOTS["cylinder"]


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def batch() -> Batch:
    return Generator(library(12, 3), 3, samples=1).batch(0, 4, 3, SIZE)


def world(*items: tuple[int, tuple[float, ...], tuple[float, ...]], R: object = None) -> rays.Solids:
    """One scene with primitives (slot, centre, half extents), all turned by R."""
    p = sum(SLOTS.values())
    centre, half = torch.zeros(1, p, 3), torch.ones(1, p, 3)
    there = torch.zeros(1, p, dtype=torch.bool)
    for slot, c, h in items:
        centre[0, slot], half[0, slot], there[0, slot] = torch.tensor(c), torch.tensor(h), True
    turned = torch.eye(3) if R is None else R
    return rays.solids(centre, half, turned.expand(1, p, 3, 3), there, torch.tensor([[5.0, 4.0, 3.0]]))


@pytest.mark.parametrize(
    ("slot", "at", "expected"),
    [
        (BOX, (0.0, 0.0), 4.0), (BOX, (0.9, 1.9), 4.0), (BOX, (1.1, 0.0), None),
        (CYLINDER, (0.0, 0.0), 4.0), (CYLINDER, (0.7, 1.3), 4.0), (CYLINDER, (0.8, 1.7), None),
        (BALL, (0.0, 0.0), 4.0), (BALL, (0.5, 0.0), 7 - 3 * 0.75**0.5), (BALL, (0.8, 1.7), None),
    ],
)  # fmt: skip
def test_rays_from_above_hit_where_geometry_says(slot: int, at: tuple[float, float], expected: float | None) -> None:
    scene = world((slot, (0.0, 0.0, -7.0), (1.0, 2.0, 3.0)))
    t, which = rays.nearest(scene, torch.tensor([[[*at, 0.0]]]), torch.tensor([[[0.0, 0.0, -1.0]]]))
    if expected is None:
        assert t >= rays.FAR
    else:
        assert abs(float(t) - expected) < 1e-4
        assert int(which) == slot


def test_hits_lie_on_the_surface_and_normals_face_the_ray() -> None:
    R = cameras.look_at(torch.zeros(3), torch.tensor([1.0, 2.0, 0.5]), torch.tensor(0.3))[:3, :3]
    items = [(s, (x, 0.0, 0.0), (0.4, 0.5, 0.6)) for s, x in ((BOX, -2.0), (CYLINDER, 0.0), (BALL, 2.0))]
    scene = world(*items, R=R)
    rng = np.random.default_rng(0)
    origin = torch.from_numpy(rng.normal(0, 1, (1, 4000, 3))).float() * 4
    toward = torch.from_numpy(rng.normal(0, 0.5, (1, 4000, 3))).float() + origin.new_tensor(
        rng.choice([-2.0, 0.0, 2.0], 4000)
    )[None, :, None] * origin.new_tensor([1.0, 0, 0])
    t, which = rays.nearest(scene, origin, toward - origin)
    hit = (t < rays.FAR)[0]
    assert hit.float().mean() > 0.4
    points = origin + t[..., None] * (toward - origin)
    normal, own = rays.surface(scene, points, which)
    unit = own[0, hit] / torch.tensor([0.4, 0.5, 0.6])
    for slot, reach in (
        (BOX, unit.abs().amax(-1)),
        (CYLINDER, torch.maximum(unit[:, :2].norm(dim=-1), unit[:, 2].abs())),
        (BALL, unit.norm(dim=-1)),
    ):
        mine = which[0, hit] == slot
        assert mine.sum() > 100
        assert (reach[mine] - 1).abs().max() < 1e-3
    outside = (toward - origin)[0, hit]
    assert ((normal[0, hit] * outside).sum(-1) < 1e-3).float().mean() > 0.99


def test_rays_leave_the_room_through_the_right_face() -> None:
    scene = world()
    d = torch.tensor([[[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0, 0, -1.0]]])
    t, face = rays.walls(scene, torch.tensor([[[1.0, 0, 1.0]]]), d)
    assert t[0].tolist() == pytest.approx([4, 6, 4, 2, 1])
    assert face[0].tolist() == [3, 2, 5, 1, 0]


def test_views_show_one_world(batch: Batch) -> None:
    """True points of one view, looked at by another, have the depth that the other has there, or are hidden."""
    points, inverse = batch.first_points(), cameras.inverse(batch.T)
    agree = []
    for i, j in ((0, 1), (2, 0)):
        p = torch.einsum("bij,bhwj->bhwi", inverse[:, j, :3, :3], points[:, i]) + inverse[:, j, None, None, :3, 3]
        K = batch.K[:, j, None, None]
        u = (p[..., 0] / p[..., 2] * K[..., 0, 0] + K[..., 0, 2]).round().long()
        v = (p[..., 1] / p[..., 2] * K[..., 1, 1] + K[..., 1, 2]).round().long()
        inside = (p[..., 2] > 0.1) & (u >= 0) & (v >= 0) & (u < SIZE[1]) & (v < SIZE[0]) & (batch.depth[:, i] > 0)
        b = torch.arange(len(u))[:, None, None].expand_as(u)[inside]
        there = batch.depth[b, j, v[inside], u[inside]]
        agree.append((there - p[..., 2][inside]) / p[..., 2][inside])
    off = torch.cat(agree)
    assert len(off) > 3000
    assert off.abs().median() < 0.01  # half a pixel of a slanted surface
    assert (off < 0.05).float().mean() > 0.9  # nearer: hidden; farther: impossible


def test_the_truth_is_relative_to_the_first_camera(batch: Batch) -> None:
    torch.testing.assert_close(batch.T[:, 0], torch.eye(4).expand(4, 4, 4), atol=1e-5, rtol=0)
    R = batch.T[..., :3, :3]
    torch.testing.assert_close(R @ R.transpose(-1, -2), torch.eye(3).expand_as(R), atol=1e-5, rtol=0)
    torch.testing.assert_close(batch.local_points()[..., 2], batch.depth)


def test_a_seed_is_a_batch_in_whatever_order() -> None:
    size = (32, 48)
    first = Generator(library(4, 3), 3).batch(0, 2, 2, size)
    made = Generator(library(4, 3), 3)
    other = made.batch(1, 2, 2, size)
    rendered = made.render(0, 2, 2, size)
    again, twice = made.observe(rendered, 0), made.observe(rendered, 0, again=1)
    assert torch.equal(again.images, first.images)
    assert torch.equal(again.sensor, first.sensor)
    assert torch.equal(twice.depth, first.depth)
    assert not torch.equal(twice.images, first.images)
    assert not torch.equal(other.images, first.images)


def test_some_scenes_have_sensor_depth_near_the_truth_and_some_have_none(batch: Batch) -> None:
    seen = (batch.sensor > 0).flatten(1).any(1)
    assert 0 < seen.sum() < len(seen)
    both = (batch.sensor > 0) & (batch.depth > 0)
    off = (batch.sensor[both] / batch.depth[both] - 1).abs()
    assert 1e-4 < off.median() < 0.03
    assert 0.2 < both[seen].float().mean() < 0.99  # with holes


@pytest.mark.parametrize("kind", LAYOUTS)
def test_layouts_stand_on_the_floor_and_are_the_same_again(kind: str) -> None:
    a, b = library(4, 7, (kind,)), library(2, 7, (kind,))
    assert np.array_equal(a.centre[:2], b.centre)
    assert (a.there.sum(1) >= 1).all()
    assert set(a.kind) == {kind}
    R = a.R[a.there]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-5)
    highest = (a.centre[..., 2] + a.half.max(-1))[a.there]
    assert (highest > 0).all()


def test_unknown_kinds_are_named() -> None:
    with pytest.raises(RealsimError, match="no such kind"):
        library(1, 0, ("moon",))


def test_jpeg_keeps_what_is_flat_and_loses_what_is_fine() -> None:
    flat = torch.tensor([0.2, 0.5, 0.7])[None, :, None, None].expand(1, 3, 20, 20)
    torch.testing.assert_close(sensor.jpeg(flat, torch.tensor([1.0])), flat, atol=0.03, rtol=0)
    fine = Draw.of(0, 0, "cpu").uniform(0, 1, 1, 3, 32, 32)
    off = [float((sensor.jpeg(fine, torch.tensor([s])) - fine).abs().mean()) for s in (1e-3, 0.2, 4.0)]
    assert off[0] < 0.01
    assert off == sorted(off)
