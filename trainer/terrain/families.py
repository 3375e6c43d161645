"""The families, one function each: `(difficulty 0..1, rng) -> Course`; harder is sparser, smaller, steeper.

The paper (section V-A) gives the families and says that difficulty is larger gaps and smaller footholds, with position,
size and shape drawn at random; it gives no figures. Those here are chosen so that 0 is a pavement with joints and 1 is
at the limit of a G1, whose foot is 17 to 20 cm long and 6 cm wide.
"""

import numpy as np

from realsim.core.geometry import make_T
from trainer.terrain.base import Box
from trainer.terrain.course import PLATFORM, Course
from trainer.terrain.shapes import block, frustum, leaning, moved

Rng = np.random.Generator
COURSE = 2.6
"""Metres between the platforms, about."""


def between(easy: float, hard: float, difficulty: float) -> float:
    """Linear from `easy` at 0 to `hard` at 1."""
    return easy + (hard - easy) * difficulty


def wedges(difficulty: float, rng: Rng, length: float = COURSE) -> Course:
    """Blocks with tilted tops across the whole path, the tilt's direction drawn for each."""
    gap, tilt = between(0.04, 0.22, difficulty), np.radians(between(4, 20, difficulty))
    depth, width = between(0.55, 0.34, difficulty), between(0.8, 0.5, difficulty)
    boxes, x = [], gap
    while x < length - depth / 2:
        long = depth * rng.uniform(0.9, 1.1)
        toward = rng.choice([np.pi / 2, -np.pi / 2, 0.0, np.pi]) + rng.normal(0, 0.1)
        height = rng.uniform(0.24, 0.32)
        boxes.append(leaning(x + long / 2, rng.normal(0, 0.03), (long, width, height), tilt, float(toward)))
        x += long + gap * rng.uniform(0.8, 1.2)
    return Course(boxes, x, {"gap": gap, "tilt": float(tilt), "depth": depth, "width": width})


def stakes(difficulty: float, rng: Rng, length: float = COURSE) -> Course:
    """Two rows of square stakes, a foothold for each foot."""
    width, pitch = between(0.42, 0.16, difficulty), between(0.44, 0.46, difficulty)
    noise, drop = between(0.0, 0.05, difficulty), between(0.02, 0.12, difficulty)
    side = max(0.13, width / 2 + 0.01)
    boxes = []
    for i in range(2 * round(length / pitch)):
        x = pitch * (i // 2 + 0.5) + rng.normal(0, noise) + (i % 2) * pitch * 0.25 * difficulty
        wide = width * rng.uniform(0.92, 1.08)
        size = (wide, wide * rng.uniform(0.92, 1.08), 0.35 - rng.uniform(0, drop))
        boxes.append(block(x, (-1) ** i * side + rng.normal(0, noise), size, rng.normal(0, 0.3) * difficulty))
    whole = pitch * round(length / pitch) + 0.2 * difficulty
    return Course(boxes, whole, {"width": width, "pitch": pitch, "noise": noise, "gap": pitch - width})


def boxes(difficulty: float, rng: Rng, length: float = COURSE) -> Course:
    """Boxes of different height across the path, stepped onto and over."""
    gap, depth = between(0.03, 0.28, difficulty), between(0.6, 0.32, difficulty)
    step, width = between(0.02, 0.15, difficulty), between(0.8, 0.5, difficulty)
    out, x = [], gap
    while x < length - depth / 2:
        long = depth * rng.uniform(0.9, 1.15)
        size = (long, width * rng.uniform(0.9, 1.1), 0.35 + rng.uniform(-step, step))
        out.append(block(x + long / 2, rng.normal(0, 0.04), size, rng.normal(0, 0.08) * difficulty))
        x += long + gap * rng.uniform(0.8, 1.2)
    return Course(out, x, {"gap": gap, "depth": depth, "step": step, "width": width})


def trapezoids(difficulty: float, rng: Rng, length: float = COURSE) -> Course:
    """Ridges across the path with a level top and sloping flanks."""
    top, flank = between(0.45, 0.14, difficulty), np.radians(between(20, 42, difficulty))
    width, valley = between(0.8, 0.55, difficulty), between(0.02, 0.14, difficulty)
    out, x = [], 0.0
    while x < length - 0.3:
        height = 0.33 - rng.uniform(0, between(0.02, 0.08, difficulty))
        # Flanks are cut by the neighbours: what stays between two ridges is a V whose bottom lies `valley` below.
        run = top * rng.uniform(0.9, 1.1)
        middle = x + valley / np.tan(flank) + run / 2
        out += frustum(middle, rng.normal(0, 0.03), (run, width), height, float(flank), rng.normal(0, 0.05))
        x = middle + run / 2 + valley / np.tan(flank)
    return Course(out, x + 0.05, {"top": top, "flank": float(flank), "valley": valley, "width": width})


def beams(difficulty: float, rng: Rng, length: float = COURSE) -> Course:
    """Narrow beams along the path, one after the other."""
    width, gap = between(0.5, 0.13, difficulty), between(0.02, 0.18, difficulty)
    aside, turn = between(0.0, 0.10, difficulty), between(0.0, 0.10, difficulty)
    out, x = [], gap
    count = round(3 * length / COURSE)
    for _ in range(count):
        long = length / count - gap
        size = (long, width * rng.uniform(0.95, 1.1), 0.35 - rng.uniform(0, between(0.0, 0.08, difficulty)))
        out.append(block(x + long / 2, rng.uniform(-aside, aside), size, rng.uniform(-turn, turn)))
        x += long + gap
    return Course(out, x, {"width": width, "gap": gap, "aside": aside})


def mixed(difficulty: float, rng: Rng) -> Course:
    """A short course of three families drawn at random, end to end: each begins with its own gap."""
    out: list[Box] = []
    facts: dict[str, float] = {}
    x = 0.0
    kinds = {"wedges": wedges, "stakes": stakes, "boxes": boxes, "trapezoids": trapezoids, "beams": beams}
    for name in rng.permutation(list(kinds))[:3]:
        piece = kinds[name](difficulty, rng, COURSE / 3)
        out += [moved(b, make_T(np.eye(3), np.array([x, 0.0, 0.0]))) for b in piece.boxes]
        x += max(_far_edge(b) for b in piece.boxes)
        facts |= {f"{name}_{k}": v for k, v in piece.facts.items()}
    return Course(out, x + between(0.03, 0.12, difficulty), facts)


def _far_edge(box: Box) -> float:
    """x in metres at which the box's upper face ends; of the flank of a ridge, where it begins."""
    steep = box.T[2, 2] < 0.94  # 20 degrees: no foothold beyond the ridge
    half = 0.0 if steep else np.abs(box.T[0, :2]) @ box.size[:2] / 2
    return float(box.T[0, 3] + box.T[0, 2] * box.size[2] / 2 + half)


def bends(difficulty: float, rng: Rng) -> Course:
    """Boxes along an arc to the left or to the right: the goal lies to the side."""
    turn = np.radians(between(20, 100, difficulty) * rng.uniform(0.8, 1.0)) * rng.choice([-1, 1])
    gap, depth = between(0.03, 0.20, difficulty), between(0.55, 0.34, difficulty)
    step, width = between(0.02, 0.08, difficulty), between(0.8, 0.5, difficulty)
    bend = turn / COURSE  # 1/m

    def at(s: float) -> tuple[float, float, float]:
        """x, y and heading, s metres along the arc."""
        return np.sin(bend * s) / bend, (1 - np.cos(bend * s)) / bend, bend * s

    out, s = [], gap
    while s < COURSE - depth / 2:
        long = depth * rng.uniform(0.9, 1.1)
        x, y, heading = at(s + long / 2)
        out.append(block(x, y, (long, width, 0.35 + rng.uniform(-step, step)), heading))
        s += long + gap * rng.uniform(0.8, 1.2)
    x, y, heading = at(s)
    # The goal platform keeps the start's axes: its middle lies ahead, by half of what it measures in that direction.
    half = min(PLATFORM[0] / abs(np.cos(heading)), PLATFORM[1] / max(abs(np.sin(heading)), 1e-6)) / 2
    x, y = x + half * np.cos(heading), y + half * np.sin(heading)
    facts = {"turn": float(abs(turn)), "gap": gap, "depth": depth, "step": step, "width": width}
    return Course(out, x - PLATFORM[0] / 2, facts, goal_y=y)


def boston(difficulty: float, rng: Rng) -> Course:
    """A circle of wedges, all leaning outward: the path bends round it, and every foothold slopes sideways."""
    radius, count = 0.85, 10
    tilt, gap = np.radians(between(6, 20, difficulty)), between(0.02, 0.10, difficulty)
    pitch = 2 * np.pi * radius / count
    out = []
    for k in range(count):
        angle = 2 * np.pi * (k + 0.5) / count + rng.normal(0, 0.03) * difficulty
        x, y = radius * (1 - np.cos(angle)), radius * np.sin(angle)
        heading = np.arctan2(y, x - radius)  # away from the middle
        size = (between(0.5, 0.36, difficulty), pitch - gap, rng.uniform(0.25, 0.31))
        out.append(leaning(x + 0.30, y, size, float(tilt), float(heading)))
    return Course(out, 2 * radius + 0.60, {"radius": radius, "tilt": float(tilt), "gap": gap})
