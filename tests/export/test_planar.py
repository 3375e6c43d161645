"""Clutter: surfaces of very many planes must not cost memory by the plane."""

import tracemalloc

import numpy as np

from realsim.export.contact.columns import Columns
from realsim.export.contact.islands import Island, Terrain
from realsim.export.contact.outline import outlines
from realsim.export.contact.planar import planar
from realsim.export.contact.prisms import Prism

CELL = 0.005


def test_many_planes_need_no_image_each() -> None:
    """A scanned room made 1600 planes; one image of misfits for each of them took 4 GB."""
    tiles, side = 12, 10
    heights = np.random.default_rng(0).uniform(0.1, 1.5, (tiles, tiles))
    top = heights.repeat(side, 0).repeat(side, 1)
    seen = np.ones((1, *top.shape), bool)
    grid = Columns(np.zeros(2), CELL, top[None], seen, np.full(seen.shape, -np.inf), ~seen)
    island = Island((0, 0), top, np.zeros_like(top))
    whole = Terrain(grid, (island,), 0.0, (), 0.003, 3, (0.0, 0.0))
    planar(whole, Island((0, 0), top[:side, :side], np.zeros((side, side))))  # imports are no part of what is measured
    tracemalloc.start()
    found = planar(whole, island)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(found.prisms) == tiles**2
    assert peak < 0.4 * tiles**2 * top.nbytes


def test_a_ragged_outline_takes_no_memory_by_pairs() -> None:
    """Points of a trace against sides of its outline: a corridor of 20 m took 3 GB, half of it 0.7 GB."""
    rng = np.random.default_rng(0)
    teeth = 30 + rng.integers(0, 20, 800)  # one row of a comb a column
    mask = np.arange(60)[:, None] < teeth
    outlines(mask[:, :50], 1.0)
    tracemalloc.start()
    (ring,) = outlines(mask, 1.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(ring) > 300
    assert peak < 100e6


def test_a_part_without_volume_is_known_as_flat() -> None:
    """MuJoCo refuses to make a hull of it, and a scene with one would not compile."""
    square = np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]])
    slope = square @ [0.3, 0.2]
    assert Prism(square, slope, slope).flat
    assert Prism(square * [1, 1e-5], np.ones(4), np.zeros(4)).flat
    assert not Prism(square, slope + 0.006, slope).flat


def test_a_bit_that_floats_has_no_pillar_below_it() -> None:
    """A round blob of a scan whose underside is no plane, and one column of it of which a ray missed the underside."""
    x, y = np.meshgrid(*[(np.arange(14) - 6.5) * CELL] * 2)
    half = np.sqrt(np.where(np.hypot(x, y) < 0.031, 0.035**2 - x**2 - y**2, np.nan))
    under = 0.8 - half - 0.008 * (np.arange(14) % 2)
    under[np.argwhere(np.isfinite(under))[0][0], np.argwhere(np.isfinite(under))[0][1]] = 0.0
    top = np.where(np.isfinite(half), 0.82, np.nan)
    seen = np.ones((1, 14, 14), bool)
    grid = Columns(np.zeros(2), CELL, top[None], seen, under[None], seen)
    island = Island((0, 0), top, under)
    found = planar(Terrain(grid, (island,), 0.0, (), 0.003, 3, (0.0, 0.0)), island)
    bottoms = [float(prism.bottom.min()) for prism in found.prisms]
    assert bottoms
    assert min(bottoms) > 0.7
