"""Laws that hold for any input: association, pose interpolation, matrix order, rigidity, the choice of frames."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from realsim.capture.association import associate, interpolate_poses
from realsim.capture.intrinsics import camera_matrix
from realsim.capture.listing import natural_key, pair_by_stem
from realsim.capture.lzf import decompress
from realsim.capture.poses import MENDABLE, rigid
from realsim.capture.selection import pick
from realsim.capture.survey import Look, sharpness
from realsim.core.errors import CaptureError
from realsim.core.geometry import angle_deg, exp_so3, is_rotation, make_T
from realsim.core.types import Frame, Intrinsics

FAST = settings(max_examples=60, deadline=None)
times = st.lists(st.integers(0, 10_000), max_size=30, unique=True).map(lambda v: np.array(sorted(v)) / 1000)
vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@FAST
@given(times, times, st.floats(0, 0.5))
def test_association_is_one_to_one_in_order_close_and_symmetric(a, b, limit):
    pairs = associate(a, b, limit)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
    assert pairs == sorted(pairs)
    assert [j for _, j in pairs] == sorted(j for _, j in pairs)
    assert all(abs(a[i] - b[j]) <= limit for i, j in pairs)
    mirrored = {(j, i) for j, i in associate(-b[::-1], -a[::-1], limit)}
    same = {(len(b) - 1 - j, len(a) - 1 - i) for i, j in pairs}
    # Exact ties go to the earlier one, which is the other one when time runs backward.
    apart = np.abs(a[:, None] - b)
    ties = any(len(np.unique(row)) < len(row) for way in (apart, apart.T) for row in way)
    assert ties or mirrored == same


@FAST
@given(times, st.floats(0, 0.4))
def test_association_finds_a_constant_shift(a, share):
    assume(len(a) > 1)
    shift = share * float(np.diff(a).min())
    assert associate(a, a + shift, shift + 1e-9) == [(i, i) for i in range(len(a))]


@FAST
@given(vectors, vectors, vectors, vectors, st.floats(0.05, 0.95))
def test_interpolation_moves_evenly_between_two_poses(w0, t0, w1, t1, share):
    A, B = make_T(exp_so3(w0), t0), make_T(exp_so3(w1), t1)
    (T,) = interpolate_poses(np.array([10.0, 10.1]), np.array([A, B]), np.array([10 + 0.1 * share]), 0.2)
    assert T is not None
    assert is_rotation(T[:3, :3])
    np.testing.assert_allclose(T[:3, 3], (1 - share) * t0 + share * t1, atol=1e-9)
    whole = angle_deg(A[:3, :3].T @ B[:3, :3])
    assert angle_deg(A[:3, :3].T @ T[:3, :3]) == pytest.approx(share * whole, abs=1e-4)


def test_interpolation_does_not_bridge_gaps_or_leave_the_samples():
    stamps, poses = np.array([0.0, 0.1, 1.0]), np.repeat(np.eye(4)[None], 3, 0)
    found = interpolate_poses(stamps, poses, np.array([-0.05, 0.0, 0.05, 0.5, 1.0, 1.05]), 0.2)
    assert [T is not None for T in found] == [False, True, True, False, True, False]


@FAST
@given(st.floats(50, 3000), st.floats(0.8, 1.2), st.floats(1, 2000), st.floats(1, 2000))
def test_the_order_of_a_camera_matrix_is_recognised(fx, ratio, cx, cy):
    K = Intrinsics(4000, 4000, fx, fx * ratio, cx, cy).K
    for written, order in ((K, "row by row"), (K.T, "column by column")):
        for values in (written, written.ravel().tolist()):
            found, said = camera_matrix(values, Path("k.json"))
            np.testing.assert_array_equal(found, K)
            assert said == order
        padded = np.eye(4)
        padded[:3, :3] = written
        np.testing.assert_array_equal(camera_matrix(padded, Path("k.txt"))[0], K)


def test_a_camera_matrix_without_principal_point_is_not_guessed():
    with pytest.raises(CaptureError, match="not a camera matrix"):
        camera_matrix(np.diag([500.0, 500, 1]), Path("k.json"))


@FAST
@given(vectors, vectors, st.integers(0, 2**32 - 1), st.floats(0, 0.01))
def test_rigid_mends_a_little_and_refuses_a_lot(w, t, seed, noise):
    R = exp_so3(w)
    error = np.random.default_rng(seed).uniform(-noise, noise, (3, 3))
    result = rigid(make_T(R + error, t))
    assert not isinstance(result, str)
    T, deviation = result
    assert is_rotation(T[:3, :3], 1e-9)
    np.testing.assert_array_equal(T[:3, 3], t)
    assert angle_deg(R.T @ T[:3, :3]) < np.degrees(4 * noise) + 1e-5
    assert deviation <= MENDABLE + 1e-9
    assert isinstance(rigid(make_T(R @ np.diag([1, 1, -1]), t)), str)
    assert isinstance(rigid(make_T(R * 1.5, t)), str)


@FAST
@given(st.lists(st.integers(0, 99_999), unique=True, min_size=1, max_size=30))
def test_files_are_paired_and_ordered_by_number(numbers):
    pairs, _ = pair_by_stem([Path(f"c_{n}.jpg") for n in numbers], [Path(f"d_{n:05d}.png") for n in numbers[::-1]])
    assert [int(p.name) for p in pairs] == sorted(numbers)
    assert all(p.color and p.depth and int(p.color.stem[2:]) == int(p.depth.stem[2:]) for p in pairs)
    assert sorted(map(str, numbers), key=natural_key) == [str(n) for n in sorted(numbers)]


def compress(data: bytes) -> bytes:
    """A small LZF compressor: greedy, one table of the last place of each three bytes. Only to test the reader."""
    out, literal, last, at = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for start in range(0, len(literal), 32):
            run = literal[start : start + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literal.clear()

    while at < len(data):
        key = data[at : at + 3]
        back = at - last.get(key, -10_000) - 1
        last[key] = at
        if len(key) == 3 and 0 <= back < 8192:
            length = 3
            while at + length < len(data) and length < 264 and data[at + length] == data[at - back - 1 + length]:
                length += 1
            flush()
            code = length - 2
            out.append((min(code, 7) << 5) | (back >> 8))
            if code >= 7:
                out.append(code - 7)
            out.append(back & 255)
            at += length
        else:
            literal.append(data[at])
            at += 1
    flush()
    return bytes(out)


@FAST
@given(st.lists(st.tuples(st.binary(min_size=1, max_size=12), st.integers(1, 60)), max_size=12))
def test_lzf_unpacks_what_was_packed(parts):
    data = b"".join(piece * times for piece, times in parts)
    assert decompress(compress(data), len(data)) == data


@FAST
@given(st.binary(max_size=200), st.integers(0, 400))
def test_lzf_never_returns_another_size(data, size):
    try:
        assert len(decompress(data, size)) == size
    except ValueError as error:
        assert "compressed data" in str(error)  # noqa: PT017


# ---------------------------------------------------------------- the choice among too many frames


def capture(positions, sharp, posed=True):
    camera = Intrinsics(4, 4, 4, 4, 1.5, 1.5)
    frames, looks = [], []
    for i, (x, s) in enumerate(zip(positions, sharp, strict=True)):
        pose = make_T(None, [x, 0, 0]) if posed else None
        frames.append(Frame(f"f{i}", camera, lambda: np.ones((4, 4), np.float32), T_world_camera=pose))
        thumbnail = np.sin(np.arange(768).reshape(24, 32) / 5 + x).astype(np.float32)
        thumbnail = (thumbnail - thumbnail.mean()) / thumbnail.std()
        looks.append(Look(f"f{i}", 1.0, (0.5, 2.0), 1.0, s, str(i), thumbnail, ((4, 4), (4, 4))))
    return frames, looks


@FAST
@given(st.integers(2, 120), st.integers(1, 40), st.integers(0, 1000), st.booleans())
def test_at_most_the_limit_is_kept_and_always_the_same(count, limit, seed, posed):
    rng = np.random.default_rng(seed)
    frames, looks = capture(np.cumsum(rng.uniform(0, 0.3, count)), rng.uniform(0.1, 1, count), posed)
    dropped = pick(frames, looks, limit)
    assert dropped == pick(frames, looks, limit)
    assert not any(d.lost for d in dropped)
    kept = count - len(dropped)
    if count <= limit:
        assert kept == count
    else:
        assert 0.6 * limit < kept <= limit, "stretches without frames must not cost much of what is allowed"


def test_a_pause_costs_few_frames_and_the_sharpest_are_taken():
    # 60 frames at rest, 60 moving on; every other one is soft.
    positions = np.concatenate([np.zeros(60), np.arange(1, 61) * 0.1])
    sharp = np.where(np.arange(120) % 2, 1.0, 0.5)
    frames, looks = capture(positions, sharp)
    gone = {d.name for d in pick(frames, looks, 30)}
    kept = [i for i in range(120) if f"f{i}" not in gone]
    assert len(kept) >= 27
    assert sum(i < 60 for i in kept) <= 5
    assert np.mean(sharp[kept] == 1.0) > 0.9
    moving = positions[[i for i in kept if i >= 60]]
    assert np.diff(moving).max() < 0.5


def test_sharpness_falls_with_blur_and_hardly_with_exposure():
    import cv2

    rng = np.random.default_rng(3)
    image = cv2.GaussianBlur(rng.integers(0, 256, (240, 320), dtype=np.uint8), (0, 0), 1.0)
    image = cv2.addWeighted(image, 0.5, cv2.resize(image[:30, :40], (320, 240)), 0.5, 0)
    smear = np.zeros((9, 9), np.float32)
    smear[4] = 1 / 9
    full = sharpness(image)
    for kernel in (smear, smear.T):
        assert sharpness(cv2.filter2D(image, -1, kernel)) < 0.2 * full
    assert sharpness((image * 0.5).astype(np.uint8)) == pytest.approx(full, rel=0.2)
