"""Pairs of scans of one place, with noise and each in a frame of its own: what changed is found, and nothing else."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from realsim.changes import Changes, Surface, compare
from realsim.core.errors import RealsimError
from realsim.core.geometry import exp_so3, make_T, transform


@dataclass(frozen=True)
class Thing:
    """A box that stands on the floor."""

    x: float
    y: float
    along: float
    across: float
    height: float
    yaw: float = 0.0


@dataclass(frozen=True)
class Place:
    things: list[Thing] = field(default_factory=list)

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        z = np.zeros_like(x)
        for t in self.things:
            c, s = np.cos(t.yaw), np.sin(t.yaw)
            u, v = c * (x - t.x) + s * (y - t.y), -s * (x - t.x) + c * (y - t.y)
            z = np.where((np.abs(u) < t.along / 2) & (np.abs(v) < t.across / 2), np.maximum(z, t.height), z)
        return z


def scan(place: Place, seed: int, noise: float = 0.002, pitch: float = 0.01) -> Surface:
    """A surface of 3 x 2 m as a reconstruction has it: rounded, uneven by 2 mm over some centimetres, partly unseen."""
    rng = np.random.default_rng(seed)
    xs, ys = np.arange(-1.5, 1.5, pitch), np.arange(-1.0, 1.0, pitch)
    jitter = rng.uniform(-0.5, 0.5, 2) * pitch
    x, y = np.meshgrid(xs + jitter[0], ys + jitter[1], indexing="ij")
    uneven = gaussian_filter(rng.normal(size=x.shape), 2.0)
    z = gaussian_filter(place.height(x, y), 0.6) + noise * uneven / uneven.std()
    V = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (index[i : i + len(xs) - 1, j : j + len(ys) - 1].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    F = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    hidden = rng.uniform([-1.4, -0.9], [1.4, 0.9], (3, 2))
    centres = V[F].mean(1)[:, None, :2]
    F = F[(np.linalg.norm(centres - hidden, axis=2) > 0.08).all(1)]
    T = make_T(exp_so3([0, 0, rng.uniform(-0.6, 0.6)]), rng.uniform(-0.5, 0.5, 3))
    return transform(T, V), F


def room(seed: int) -> Place:
    """Six things, none of which touches another."""
    rng = np.random.default_rng([7, seed])
    places = [(x, y) for x in (-1.0, 0.0, 1.0) for y in (-0.5, 0.5)]
    return Place(
        [
            Thing(
                x + rng.uniform(-0.1, 0.1),
                y + rng.uniform(-0.1, 0.1),
                *rng.uniform(0.12, 0.4, 2),
                rng.uniform(0.06, 0.4),
                rng.uniform(-1, 1),
            )
            for x, y in places
        ]
    )


def kinds(changes: Changes) -> list[str]:
    return sorted(change.kind for change in changes.objects)


def test_a_repeat_has_no_changes():
    changes = compare(scan(room(0), 0), scan(room(0), 1))
    assert changes.objects == ()
    assert changes.compared_m2 > 4
    assert changes.noise_m < 0.006


def altered(seed: int) -> tuple[Place, list[str]]:
    """The room with one thing moved, one gone, one sunk and two small ones new, and what that is called."""
    things = room(seed).things
    rng = np.random.default_rng([9, seed])
    moved, sunk = things[0], things[3]
    turn = rng.uniform(0, 2 * np.pi)
    far = rng.uniform(0.05, 0.12)
    out = [
        Thing(
            moved.x + far * np.cos(turn),
            moved.y + far * np.sin(turn),
            moved.along,
            moved.across,
            moved.height,
            moved.yaw,
        ),
        things[2],
        Thing(sunk.x, sunk.y, sunk.along, sunk.across, sunk.height - 0.03, sunk.yaw),
        *things[4:],
        Thing(0.5, 0.0, 0.04, 0.04, 0.03, rng.uniform(0, 1)),
        Thing(-0.5, 0.0, 0.06, 0.05, 0.05, rng.uniform(0, 1)),
    ]
    return Place(out), ["appeared", "appeared", "moved", "sank", "went"]


def test_what_changed_is_found():
    """F1 over two rooms, a change counting only by its right name."""
    hits = false = missed = 0
    for seed in range(2):
        today, expected = altered(seed)
        found = kinds(compare(scan(room(seed), 100 + seed), scan(today, 200 + seed)))
        right = sum(min(found.count(kind), expected.count(kind)) for kind in set(expected))
        hits, false, missed = hits + right, false + len(found) - right, missed + len(expected) - right
    assert 2 * hits / (2 * hits + false + missed) >= 0.9


def test_figures_of_a_move():
    place = Place([Thing(-0.8, 0.2, 0.5, 0.4, 0.3), Thing(0.6, -0.2, 0.3, 0.2, 0.12), Thing(0.2, 0.6, 0.2, 0.2, 0.2)])
    today = Place([place.things[0], Thing(0.6, -0.1, 0.3, 0.2, 0.12), place.things[2]])
    before, after = scan(place, 5), scan(today, 6)
    (change,) = compare(before, after).objects
    assert change.kind == "moved"
    assert np.linalg.norm(change.shift) == pytest.approx(0.1, abs=0.01)
    assert change.size == pytest.approx([0.3, 0.2, 0.12], abs=0.025)
    assert f"moved by {100 * np.linalg.norm(change.shift):.0f} cm" in change.text()


def test_another_place_is_refused():
    rng = np.random.default_rng(1)
    hills = Place([Thing(*rng.uniform(-1, 1, 2), *rng.uniform(0.5, 1.5, 2), rng.uniform(0.2, 1.2)) for _ in range(9)])
    V, F = scan(hills, 1, pitch=0.03)
    steep = np.column_stack([V[:, :2], V[:, 2] + 0.7 * V[:, 0] ** 2 + np.sin(9 * V[:, 1])])
    with pytest.raises(RealsimError, match="laid over"):
        compare(scan(room(0), 1, pitch=0.03), (steep, F))
