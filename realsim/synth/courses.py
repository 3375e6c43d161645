"""What stands between the start and the goal platform, one function per kind.

Each takes a generator and returns `(solids, length)`: obstacles standing on the floor z = 0 with the course along +x
from x = 0 to x = `length`, and y = 0 its middle. The sizes are those of the paper's terrains.
"""

import numpy as np

from realsim.synth.solids import Solid, box, cylinder, prism, rz

Course = tuple[list[Solid], float]


def _material(rng: np.random.Generator) -> str:
    return str(rng.choice(["wood", "cardboard", "osb", "concrete"]))


def stakes(rng: np.random.Generator) -> Course:
    """Two rows of stakes, square and round, 15 to 27 cm across, 20 to 35 cm high."""
    solids, pitch = [], 0.38
    for i in range(12):
        x, y = 0.24 + pitch * (i // 2) + rng.uniform(-0.04, 0.04), (-1) ** i * 0.19 + rng.uniform(-0.03, 0.03)
        width, height = rng.uniform(0.15, 0.26), rng.uniform(0.20, 0.35)
        if rng.random() < 0.5:
            solid = cylinder(f"stake_{i:02d}", width, height, _material(rng))
        else:
            solid = box(f"stake_{i:02d}", (width, width * rng.uniform(0.9, 1.1), height), _material(rng))
        solids.append(solid.moved(rz(rng.uniform(-0.7, 0.7)), (x, y, 0)))
    return solids, 0.24 + pitch * 5 + 0.24


def beams(rng: np.random.Generator) -> Course:
    """Narrow beams in line, 12 to 20 cm wide; the middle one lies on supports with a gap below."""
    solids: list[Solid] = []
    x = 0.10
    for i in range(3):
        length, width = rng.uniform(0.85, 1.05), rng.uniform(0.12, 0.20)
        y, yaw = rng.uniform(-0.12, 0.12), rng.uniform(-0.10, 0.10)
        at = (x + length / 2, y, 0)
        if i == 1:
            solids += _raised(f"beam_{i}", length, width, rng.uniform(0.22, 0.25), rng, at, yaw)
        else:
            height = rng.uniform(0.26, 0.33)
            solids.append(box(f"beam_{i}", (length, width, height), _material(rng)).moved(rz(yaw), at))
        x += length + 0.10
    return solids, x


def _raised(
    name: str, length: float, width: float, clearance: float, rng: np.random.Generator, at: tuple, yaw: float
) -> list[Solid]:
    """A plank on two supports."""
    parts = [
        box(f"{name}_support{k}", (0.16, width + 0.04, clearance), _material(rng)).moved(np.eye(3), (sx, 0, 0))
        for k, sx in enumerate((-length / 2 + 0.14, length / 2 - 0.14))
    ]
    parts.append(box(name, (length, width, 0.07), "wood").moved(np.eye(3), (0, 0, clearance)))
    return [p.moved(rz(yaw), at) for p in parts]


def wedges(rng: np.random.Generator) -> Course:
    """Wedges that slope to alternating sides by 10 to 20 degrees, 40 cm deep."""
    solids, depth = [], 0.42
    for i in range(4):
        slope = (-1) ** i * 0.6 * np.tan(np.radians(rng.uniform(10, 20)))
        solid = prism(f"wedge_{i}", (depth, 0.6, rng.uniform(0.20, 0.26)), _material(rng), slope=slope)
        solids.append(solid.moved(rz(rng.uniform(-0.06, 0.06)), (0.10 + depth / 2 + i * (depth + 0.14), 0, 0)))
    return solids, 0.10 + 4 * (depth + 0.14)


def boxes(rng: np.random.Generator) -> Course:
    """Boxes of different height, to be stepped over or onto."""
    solids, x = [], 0.12
    for i in range(4):
        depth = rng.uniform(0.30, 0.45)
        solid = box(f"box_{i}", (depth, rng.uniform(0.5, 0.7), rng.uniform(0.12, 0.36)), _material(rng))
        solids.append(solid.moved(rz(rng.uniform(-0.12, 0.12)), (x + depth / 2, rng.uniform(-0.08, 0.08), 0)))
        x += depth + rng.uniform(0.10, 0.20)
    return solids, x


def trapezoids(rng: np.random.Generator) -> Course:
    """Frusta whose tops are half as long as their feet, so that fore and aft sides are slopes of 55 to 70 degrees."""
    solids, x = [], 0.10
    for i in range(4):
        depth, height = rng.uniform(0.45, 0.60), rng.uniform(0.22, 0.33)
        top = (rng.uniform(0.45, 0.60), rng.uniform(0.85, 1.0))
        solid = prism(f"trapezoid_{i}", (depth, rng.uniform(0.6, 0.75), height), _material(rng), top=top)
        solids.append(solid.moved(rz(rng.uniform(-0.08, 0.08)), (x + depth / 2, rng.uniform(-0.05, 0.05), 0)))
        x += depth + rng.uniform(0.05, 0.14)
    return solids, x


def boston(rng: np.random.Generator) -> Course:
    """Wedges in an arc to one side of the straight line, each turned along the arc and sloping to its outside."""
    solids, radius, side = [], 0.85, rng.choice([-1.0, 1.0])
    angles = np.linspace(0.12 * np.pi, 0.88 * np.pi, 5)
    for i, angle in enumerate(angles):
        at = (0.12 + radius * (1 - np.cos(angle)), side * radius * np.sin(angle) * 0.6, 0)
        slope = -side * 0.45 * np.tan(np.radians(rng.uniform(10, 18)))
        solid = prism(f"wedge_{i}", (0.36, 0.45, rng.uniform(0.20, 0.28)), _material(rng), slope=slope)
        heading = side * np.arctan2(0.6 * np.cos(angle), np.sin(angle)) + rng.uniform(-0.06, 0.06)
        solids.append(solid.moved(rz(heading), at))
    return solids, 0.24 + 2 * radius


def mixed(rng: np.random.Generator) -> Course:
    """Two stakes, a raised beam, a wedge, a trapezoid and a box."""
    at = [0.26, 0.97, 1.78, 2.40, 3.00]
    solids = [
        box(f"stake_{k}", (0.2, 0.2, height), _material(rng)).moved(rz(rng.uniform(-0.5, 0.5)), (at[0], y, 0))
        for k, (y, height) in enumerate(zip((-0.19, 0.19), rng.uniform(0.2, 0.3, 2), strict=True))
    ]
    solids += _raised("beam", 0.9, 0.17, 0.23, rng, (at[1], rng.uniform(-0.06, 0.06), 0), rng.uniform(-0.08, 0.08))
    solids.append(prism("wedge", (0.42, 0.7, 0.24), "osb", slope=0.16).moved(rz(0.03), (at[2], 0, 0)))
    solids.append(prism("trapezoid", (0.52, 0.7, 0.31), "foam", top=(0.5, 0.9)).moved(rz(-0.04), (at[3], 0, 0)))
    solids.append(box("box", (0.38, 0.6, 0.22), "cardboard").moved(rz(0.08), (at[4], -0.05, 0)))
    return solids, 3.25
