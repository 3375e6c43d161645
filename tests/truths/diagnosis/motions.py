"""Commands that a careful operator records: sweeps, steps, slow and fast, and for legs sway and stepping in place."""

import numpy as np

from tests.truths.diagnosis.robots import Robot


def sample_times(rng: np.random.Generator, rate: float, seconds: float) -> np.ndarray:
    """(T,) s: a PC's clock, nearly even, with the scatter of its scheduler."""
    n = int(seconds * rate)
    nominal = np.arange(n) / rate
    return np.sort(nominal + rng.uniform(-0.0005, 0.0005, n))


def motion(robot: Robot, rng: np.random.Generator, times: np.ndarray, kind: str) -> np.ndarray:
    """(T, J) rad commands that start at home and stay within the robot's reach."""
    t = times - times[0]
    ramp = np.clip(t / 0.6, 0, 1)[:, None]
    if robot.base == "floating":
        return robot.home + ramp * _stance(robot, rng, t, kind)
    draw = {"sines": _sines, "steps": _steps, "chirp": _chirp, "slow": _slow}[kind]
    return robot.home + ramp * draw(rng, t, len(robot.joints)) * robot.reach


KINDS = {
    "fixed": ("sines", "steps", "chirp", "slow", "sines", "steps"),
    "floating": ("sway", "step", "squat", "sway", "step", "sway"),
}


def _sines(rng: np.random.Generator, t: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros((len(t), n))
    for j in range(n):
        for f in rng.uniform(0.25, 2.2, 4):
            out[:, j] += rng.uniform(0.15, 0.4) * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi))
    return out - out[0]


def _steps(rng: np.random.Generator, t: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros((len(t), n))
    for j in range(n):
        edges = np.sort(rng.uniform(0.3, t[-1], 7))
        levels = np.concatenate([[0.0], rng.uniform(-0.8, 0.8, 7)])
        out[:, j] = levels[np.searchsorted(edges, t)]
    return out


def _chirp(rng: np.random.Generator, t: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros((len(t), n))
    for j in range(n):
        f0, f1 = rng.uniform(0.2, 0.5), rng.uniform(2.0, 4.0)
        phase = 2 * np.pi * (f0 * t + 0.5 * (f1 - f0) * t**2 / t[-1])
        out[:, j] = rng.uniform(0.3, 0.6) * np.sin(phase) * (1 - 0.6 * t / t[-1])
    return out


def _slow(rng: np.random.Generator, t: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros((len(t), n))
    for j in range(n):
        f = rng.uniform(0.12, 0.35)
        out[:, j] = rng.uniform(0.6, 0.9) * np.sin(2 * np.pi * f * t + rng.uniform(-0.3, 0.3))
    return out - out[0]


def _stance(robot: Robot, rng: np.random.Generator, t: np.ndarray, kind: str) -> np.ndarray:
    """Offsets from home for a quadruped: legs x (hip, thigh, calf)."""
    out = np.zeros((len(t), len(robot.joints)))
    legs = len(robot.joints) // 3
    if kind == "squat":
        depth = 0.18 * np.abs(np.sin(2 * np.pi * rng.uniform(0.4, 0.9) * t)) * rng.uniform(0.7, 1.1)
        for leg in range(legs):
            out[:, 3 * leg + 1], out[:, 3 * leg + 2] = depth, -2 * depth
    if kind in ("sway", "step"):
        roll, pitch = rng.uniform(0.5, 1.6, 2)
        a, b = rng.uniform(0.04, 0.10), rng.uniform(0.04, 0.09)
        if kind == "step":
            a, b = 0.3 * a, 0.3 * b
        for leg in range(legs):
            out[:, 3 * leg] += a * np.sin(2 * np.pi * roll * t)
            out[:, 3 * leg + 1] += b * np.sin(2 * np.pi * pitch * t)
    if kind == "step":
        rate = rng.uniform(1.4, 2.0)
        for leg in range(legs):
            # One diagonal pair is unloaded a little while the other stands.
            phase = rate * t + (0.5 if leg in (1, 2) else 0.0)
            lift = np.clip(np.sin(2 * np.pi * phase), 0, None) ** 2 * 0.05
            out[:, 3 * leg + 1] += lift
            out[:, 3 * leg + 2] -= 2 * lift
    return out
