"""The two casters give the same images, and both the analytic ones."""

import numpy as np
import pytest
import torch

from trainer import terrain as terrains
from trainer.rays import CASTERS

LANDS = [terrains.flat(), terrains.generate("wedges", 0.5, 0), terrains.generate("stakes", 0.5, 1)]


def made(name: str):
    if name == "warp":
        pytest.importorskip("warp", reason="the warp caster needs warp-lang")
    if name == "warp_host" and not torch.cuda.is_available():
        pytest.skip("casts on a GPU")
    return CASTERS[name](LANDS, "cpu")


def image(n: int = 6, side: int = 24) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Rays of cameras 1 m above the courses that look forward and down, some beside the course, some upwards."""
    rng = np.random.default_rng(0)
    origins = np.stack([rng.uniform(-0.5, 3, n), rng.uniform(-0.6, 0.6, n), rng.uniform(0.3, 1.2, n)], axis=1)
    y, z = np.meshgrid(np.linspace(-0.8, 0.8, side), np.linspace(-2.0, 0.2, side))
    directions = np.stack([np.ones_like(y), y, z], axis=-1).reshape(1, -1, 3)
    directions = np.repeat(directions / np.linalg.norm(directions, axis=-1, keepdims=True), n, axis=0)
    spread = np.repeat(origins[:, None], directions.shape[1], axis=1)
    ids = torch.arange(n) % len(LANDS)
    return torch.tensor(spread, dtype=torch.float32), torch.tensor(directions, dtype=torch.float32), ids


@pytest.mark.parametrize("name", list(CASTERS))
def test_ground_and_platform_are_where_they_are(name: str) -> None:
    down = torch.tensor([[[0.0, 0.0, -1.0]], [[0.0, 0.0, -1.0]], [[0.0, 0.0, 1.0]]])
    above = torch.tensor([[[0.0, 0.0, 1.5]], [[0.0, 3.0, 1.5]], [[0.0, 0.0, 1.5]]])
    for ids, expected in (([1, 1, 1], [1.5, 1.5 - LANDS[1].floor_z, 9.0]), ([0, 0, 0], [1.5, 1.5, 9.0])):
        found = made(name).cast(above, down, torch.tensor(ids), far=9.0)
        np.testing.assert_allclose(found[:, 0], expected, atol=1e-4)


def test_the_casters_agree_within_two_millimetres() -> None:
    rays = image()
    one, other = (made(name).cast(*rays, far=4.0) for name in CASTERS)
    assert one.shape == other.shape == (6, 576)
    apart = (one - other).abs()
    # A ray that grazes an edge may fall on either side of it: those are told by a depth step, and are few.
    assert float((apart > 0.002).float().mean()) < 0.002
    assert float(apart.quantile(0.99)) < 1e-4
    assert 0.05 < float((one < 4.0).float().mean()) < 1.0


@pytest.mark.parametrize("name", list(CASTERS))
def test_rows_ask_their_own_terrain_and_far_is_the_limit(name: str) -> None:
    origins, directions, ids = image()
    cast = made(name).cast
    together = cast(origins, directions, ids, 2.0)
    for i in range(len(ids)):
        alone = cast(origins[i : i + 1], directions[i : i + 1], ids[i : i + 1], 2.0)
        torch.testing.assert_close(together[i : i + 1], alone)
    assert float(together.max()) == 2.0
