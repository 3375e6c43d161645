"""Excitations by commands alone."""

import numpy as np

from realsim.core.types import F64
from realsim.gap.experiments.plan import Experiment, Rig

CHIRP_HZ = (0.3, 4.0)
SINES_HZ = (0.2, 3.0)
SINES = 6


def triangle(phase: F64) -> F64:
    """A triangle wave in -1..1 that starts at 0 upwards; phase in periods."""
    return np.asarray(4 * np.abs(np.mod(phase - 0.25, 1.0) - 0.5) - 1)


def triangles(rig: Rig, slowest: float, sign: float = 1.0) -> F64:
    """(T, U) slow triangles, a little faster from joint to joint, neighbours in turn the other way."""
    count = len(rig.home)
    rates = slowest * 1.17 ** np.arange(count)
    signs = sign * np.where(np.arange(count) % 2, -1.0, 1.0)
    return triangle(rig.time[:, None] * rates) * signs


def sines(rig: Rig, seed: int) -> F64:
    """(T, U) sums of sines of random phase in -1..1, another one a joint, their speeds alike."""
    rng = np.random.default_rng([rig.seed, seed])
    highest = min(SINES_HZ[1], rig.rate / 10)
    shape = np.zeros((len(rig.time), len(rig.home)))
    for u in range(len(rig.home)):
        for f in np.geomspace(SINES_HZ[0], highest, SINES) * rng.uniform(0.9, 1.1, SINES):
            shape[:, u] += f**-0.7 * np.sin(2 * np.pi * (f * rig.time + rng.random()))
    return np.asarray(shape / np.abs(shape).max(axis=0))


def swept(rig: Rig, sign: float) -> F64:
    """(T, U) sines whose frequency rises, their amplitude falling as the root of it; joints begin one after another."""
    low, high = CHIRP_HZ[0], min(CHIRP_HZ[1], rig.rate / 10)
    t, end = rig.time, rig.time[-1]
    shape = np.zeros((len(t), len(rig.home)))
    for u in range(len(rig.home)):
        lag = 0.05 * u
        rate = (high - low) / end
        phase = low * t + 0.5 * rate * t**2
        shape[:, u] = sign * np.sin(2 * np.pi * (phase + lag)) * np.sqrt(low / (low + rate * t))
    return shape


def slow_triangles(rig: Rig, size: float) -> Experiment | None:
    """Slow, both ways: friction and gravity alone, over the whole range."""
    runs = (
        rig.planned("slow_triangles_1", triangles(rig, 1.0 / rig.seconds), size),
        rig.planned("slow_triangles_2", triangles(rig, 2.0 / rig.seconds, -1.0), size),
    )
    return Experiment("slow_triangles", "slow triangles over the whole range", size, runs)


def chirp(rig: Rig, size: float) -> Experiment | None:
    """From slow to fast: inertia, delays and damping."""
    runs = tuple(rig.planned(f"chirp_{i + 1}", swept(rig, sign), size) for i, sign in enumerate((1.0, -1.0)))
    return Experiment("chirp", "sines from slow to fast", size, runs)


def multisine(rig: Rig, size: float) -> Experiment | None:
    """All frequencies at once."""
    runs = tuple(rig.planned(f"multisine_{i + 1}", sines(rig, i), size) for i in range(2))
    return Experiment("multisine", "sums of sines", size, runs)


def two_postures(rig: Rig, size: float) -> Experiment | None:
    """The same small motion about two postures: gravity and levers differ, friction and delays do not."""
    moved = 0.35 * sines(rig, 2)
    runs = tuple(
        rig.planned(f"two_postures_{i + 1}", np.clip(sign * 0.65 + moved, -1, 1), size)
        for i, sign in enumerate((1.0, -1.0))
    )
    return Experiment("two_postures", "the same motion in two postures", size, runs)
