"""Loops: several independent links within the chain's drift are believed, likenesses are not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import rooms
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim.core.geometry import exp_so3, invert_T, make_T
from realsim.core.types import F64, Intrinsics
from realsim.feedforward.rgbd import icp_links
from realsim.feedforward.rgbd.features import Evidence, Match, View, prepare
from realsim.feedforward.rgbd.loop_closure import join, keep_plausible
from realsim.feedforward.rgbd.matching import is_ambiguous, register_by_shape
from realsim.feedforward.rgbd.pose_graph import Edge, whitening

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


def test_a_break_is_not_bridged_by_a_jump_where_likeness_misleads() -> None:
    T = there_and_back(40)[:20]  # one way; behind frame 9 a stretch is missing
    T = np.concatenate([T[:10], make_T(None, [3.0, 0, 0]) @ T[10:]])
    chain_ = [e for e in chain(T) if e.i != 9]
    bridge = [edge(T, i, j, -2.2) for i, j in ((9, 10), (8, 10), (9, 11))]  # a bay too near: a step of 1.2 m
    wrong = [edge(T, i, i + 6, 1.2) for i in range(4)]
    found = join(blind(20), chain_ + bridge + wrong)
    assert [len(p) for p in found.parts] == [10, 10]
    honest = join(blind(20), chain_ + bridge)  # nothing speaks against likeness here
    assert len(honest.used) == 20


def test_a_break_is_bridged_where_likeness_has_proven_true() -> None:
    T = there_and_back(60)[[*range(16), *range(50, 60)]]  # 2.4 m further on while nothing was recorded
    chain_ = [e for e in chain(T) if e.i != 15]
    true = [edge(T, i, i + k) for k in (5, 6) for i in range(16 - k)]
    again = [edge(T, 9 - k, 16 + k) for k in range(5)]
    assert len(join(blind(26), chain_ + true + again).used) == 26
    few = join(blind(26), chain_ + true[:4] + again)
    assert [len(p) for p in few.parts] == [16, 10]


class Said(Evidence):
    """Evidence whose matches are given, of points 2 m away."""

    def __init__(self, n: int, edges: list[Edge]) -> None:
        points: dict[str, Any] = {"xy": np.random.default_rng(0).normal(0, 0.3, (50, 2)), "z": np.full(50, 2.0)}
        super().__init__([replace(v, **points) for v in blind(n)])
        some = np.arange(50)
        self._matches.update({(e.i, e.j): Match(e.i, e.j, some, some, e.T_i_j) for e in edges})


def test_likeness_that_the_chain_rules_out_is_no_evidence_against_poses() -> None:
    T = there_and_back(40)
    true = [*chain(T), *(edge(T, i, 39 - i) for i in range(10))]
    false = [edge(T, i, i + 6, 2.5) for i in range(20)]
    evidence = Said(40, true + false)
    kept = keep_plausible(evidence, list(evidence._matches), T)
    assert {(m.i, m.j) for m in kept} == {(e.i, e.j) for e in true}


def test_without_order_no_likeness_is_ruled_out() -> None:
    T = there_and_back(40)
    false = [edge(T, i, i + 6, 2.5) for i in range(20)]
    evidence = Said(40, false)
    assert len(keep_plausible(evidence, list(evidence._matches), T)) == 20


def test_likeness_cannot_contradict_poses_that_a_chain_of_matches_agrees_with() -> None:
    """A camera that goes fast past equal doors: neighbours match, of frames further apart most likenesses are false."""
    T = there_and_back(40)
    true, false = chain(T), [edge(T, i, i + k, 2.5) for k in (2, 3, 4) for i in range(40 - k)]
    evidence = Said(40, true + false)
    assert len(keep_plausible(evidence, list(evidence._matches), T)) == 39
    other = T.copy()
    other[:, :3, 3] *= 1.1  # another unit: nothing is exact, and far matches are off by no more than steps add up to
    evidence = Said(40, [*chain(T), *(edge(T, i, i + k) for k in (2, 3, 4, 8) for i in range(40 - k))])
    assert len(keep_plausible(evidence, list(evidence._matches), other)) == len(evidence._matches)


@given(st.integers(1, 38), st.floats(0.3, 3.0), st.floats(-1.5, 1.5))
@settings(deadline=None, max_examples=20)
def test_matches_that_a_wrong_pose_contradicts_all_stay(wrong: int, off: float, turn: float) -> None:
    T = there_and_back(40)
    evidence = Said(40, [edge(T, i, i + k) for k in (1, 2, 3) for i in range(40 - k)])
    other = T.copy()
    other[wrong] = other[wrong] @ make_T(exp_so3([0, turn, 0]), [off, 0, 0])
    kept = {(m.i, m.j) for m in keep_plausible(evidence, list(evidence._matches), other)}
    against = {pair for pair in evidence._matches if wrong in pair}
    assert against & kept
    assert kept >= set(evidence._matches) - against


def test_without_order_one_link_joins_where_no_likeness_is_false() -> None:
    T = there_and_back(40)[np.random.default_rng(1).permutation(40)]
    near = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=-1) < 0.9
    half = T[:, 0, 3] > 4.0
    pairs = [(i, j) for i in range(40) for j in range(i + 1, 40) if near[i, j] and half[i] == half[j]]
    ends = min((i, j) for i in range(40) for j in range(i + 1, 40) if near[i, j] and half[i] != half[j])
    links = [edge(T, i, j) for i, j in pairs]
    found = join(blind(40), [*links, edge(T, *ends)])
    assert len(found.used) == 40
    assert errors(found.T, T).max() < 1e-3


def test_stairs_fit_a_step_further_as_well_a_room_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def registered(shift: float) -> tuple[list[View], Edge]:
        poses = [make_T(exp_so3([-0.45, 0, 0]), at) for at in ([0, -1.3, 0], [0.05, -1.3, 0.1])]
        views = prepare([rooms.frame(k, T, color=False) for k, T in enumerate(poses)])
        found = register_by_shape(views, 0, 1, [make_T(None, [0, 0, shift])])
        assert found is not None
        return views, found

    assert not is_ambiguous(*registered(0.1))
    steps = [[[-4, -0.17 * (k + 1), 0.6 + 0.3 * k], [4, 0, 0.9 + 0.3 * k]] for k in range(20)]
    monkeypatch.setattr(rooms, "BOXES", np.array(steps))
    assert is_ambiguous(*registered(0.1))


def test_a_registration_that_puts_surfaces_into_free_space_joins_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first frame's surfaces fit the others' 1.2 m off, in the same wrong place twice: mostly floor on floor."""
    monkeypatch.setattr(icp_links, "is_ambiguous", lambda *_: False)
    T = [make_T(exp_so3([-0.6, 0, 0]), [x, -1.1, 0.0]) for x in (-1.4, -0.7, -0.6, -0.5)]
    believed, refused = icp_links.link_by_shape(
        prepare([rooms.frame(k, pose, color=False) for k, pose in enumerate(T)]), [], 0
    )
    off = [np.linalg.norm((invert_T(e.T_i_j) @ invert_T(T[e.i]) @ T[e.j])[:3, 3]) for e in [*believed, *refused]]
    assert {(e.i, e.j) for e in refused} == {(0, 1), (0, 2)}
    assert min(off[len(believed) :]) > 1
    assert len(believed) == 3
    assert max(off[: len(believed)]) < 0.01


def test_a_link_by_shape_that_no_third_frame_sees_joins_nothing() -> None:
    T = [make_T(exp_so3([-0.6, 0, 0]), [x, -1.1, 0.0]) for x in (-0.6, -0.5)]
    views = prepare([rooms.frame(k, pose, color=False) for k, pose in enumerate(T)])
    believed, refused = icp_links.link_by_shape(views, [], 0)
    assert not believed
    assert [(e.i, e.j) for e in refused] == [(0, 1)]
