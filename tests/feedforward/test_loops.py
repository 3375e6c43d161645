"""Loops: several independent links within the chain's drift are believed, likenesses are not."""

from __future__ import annotations

import numpy as np

from realsim.feedforward.rgbd.graph import Edge, whitening
from realsim.feedforward.rgbd.loops import join
from realsim.feedforward.rgbd.tracks import View
from realsim.geometry import exp_so3, invert_T, make_T
from realsim.types import F64, Intrinsics

CAMERA = Intrinsics(8, 6, 7.0, 7.0, 3.5, 2.5)


def blind(n: int) -> list[View]:
    """Views that see nothing: free space has no say, only the links have."""
    none = np.zeros((0, 2)), np.zeros(0), np.zeros((0, 128), np.float32)
    depth, normal = np.zeros((6, 8), np.float32), np.zeros((6, 8, 3), np.float32)
    return [View(f"{k:03d}", CAMERA, 7.0, depth, normal, *none, False) for k in range(n)]


def there_and_back(n: int) -> F64:
    """(n, 4, 4) 0.4 m steps along a line and back."""
    x = 0.4 * np.minimum(np.arange(n), n - 1 - np.arange(n))
    return np.stack([make_T(exp_so3([0, 0.02 * k, 0]), [x[k], 0, 0]) for k in range(n)])


def edge(T: F64, i: int, j: int, shift: float = 0.0, weight: float = 50.0) -> Edge:
    motion = invert_T(T[i]) @ make_T(None, [shift, 0, 0]) @ T[j]
    return Edge(i, j, motion, weight, whitening(0.005, 0.003))


def chain(T: F64) -> list[Edge]:
    return [edge(T, i, i + 1) for i in range(len(T) - 1)]


def errors(T: F64, truth: F64) -> F64:
    return np.linalg.norm((invert_T(truth[0]) @ truth)[:, :3, 3] - T[:, :3, 3], axis=1)


def test_likenesses_far_outside_the_drift_are_refused_whatever_their_number() -> None:
    T = there_and_back(40)
    wrong = [edge(T, i, i + 12, 2.5, 500.0) for i in range(25)]
    found = join(blind(40), chain(T) + wrong)
    assert len(found.used) == 40
    assert len(found.refused) == 25
    assert errors(found.T, T).max() < 1e-3


def test_a_loop_that_several_frames_confirm_takes_out_the_drift() -> None:
    T = there_and_back(40)
    drifting = [edge(T, i, i + 1, 0.004) for i in range(39)]
    real = [edge(T, i, 39 - i) for i in range(4)]
    assert errors(join(blind(40), drifting).T, T)[39] > 0.1
    found = join(blind(40), drifting + real)
    assert not found.refused
    assert errors(found.T, T)[39] < 0.02


def test_one_link_alone_closes_no_loop() -> None:
    T = there_and_back(40)
    found = join(blind(40), [*chain(T), edge(T, 0, 39, 0.3)])
    assert len(found.refused) == 1


def test_pieces_that_only_look_alike_stay_apart() -> None:
    T = there_and_back(30)
    cut = [e for e in chain(T) if e.i != 14]
    alike = [edge(T, i, i + 18, 2.0) for i in range(8)]
    found = join(blind(30), cut + alike)
    assert [len(p) for p in found.parts] == [15, 15]


def test_neighbours_two_steps_apart_bridge_a_gap() -> None:
    T = there_and_back(30)
    cut = [e for e in chain(T) if e.i != 14]
    bridge = [edge(T, i, i + 2) for i in range(28)]
    found = join(blind(30), cut + bridge)
    assert len(found.used) == 30
    assert errors(found.T, T).max() < 1e-3
