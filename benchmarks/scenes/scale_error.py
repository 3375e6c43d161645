"""How wrong is the scale of a scene, by where it comes from? The paper's table ("Comparison of absolute relative scale
error"), made by this tool on rendered terrains.

    python benchmarks/scenes/scale_error.py  13 terrains x 3 seeds, all sources; resumes where it stopped
    python benchmarks/scenes/scale_error.py --seconds 150    stop after that long, go on at the next call
    python benchmarks/scenes/scale_error.py --terrains Stake1 --fresh

As in the paper, each scene is registered to the true mesh by a similarity; its scale is the error. The sensor has a
scale error of its own (benchmarks/scenes/scale_sources.py states all noise), which no method without metric poses can
see. Terrains carry the paper's names and follow its descriptions; they are not its terrains. Figures go to
benchmarks/results/.
"""

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
RESULTS = ROOT / "benchmarks" / "results" / "scale_error.json"

from benchmarks.scenes.scale_sources import SOURCES, make_capture, run  # noqa: E402
from benchmarks.store import Store  # noqa: E402
from realsim.core.geometry import exp_so3, make_T  # noqa: E402
from realsim.core.rays import raycasting_scene  # noqa: E402
from realsim.feedforward.onnx.sim3 import robust_similarity  # noqa: E402

Row = dict[str, Any]

TERRAINS: dict[str, tuple[str, int]] = {
    "Boxes": ("boxes", 1),
    "Wedges": ("wedges", 2),
    "Narrow1": ("beams", 3),
    "Narrow2": ("beams", 4),
    "Narrow3": ("beams", 5),
    "Trapezoid1": ("trapezoids", 6),
    "Trapezoid2": ("trapezoids", 7),
    "Boston": ("boston", 8),
    "Stake1": ("stakes", 9),
    "Stake2": ("stakes", 10),
    "Stake3": ("stakes", 11),
    "Mix1": ("mixed", 12),
    "Mix2": ("mixed", 13),
}
"""Name -> kind and seed of its random sizes and places (realsim.synth)."""
PAPER = {
    "Stake1": {"RGB-D": 0.002, "LiDAR": 0.016, "iPhone": 0.074, "MapAnything": 0.383, "Pi3": 0.863},
    "Narrow1": {"RGB-D": 0.028, "LiDAR": 0.005, "iPhone": 0.056, "MapAnything": 0.720, "Pi3": 1.172},
}
"""TTT-Parkour's figures: theirs, on their terrains, with their sensors."""
BAR = {"mean": 0.005, "worst": 0.015, "coverage": (0.80, 0.97)}
BROKEN = 0.15
"""Metres: beyond this median error no similarity makes the scene the true one, and its scale means nothing."""
POINTS = 15_000
REACH = (0.10, 0.06, 0.04, 0.03)
"""Metres, narrowing: how far a point may be from the true surface to take part."""


@dataclass(frozen=True)
class Options:
    terrains: tuple[str, ...] = tuple(TERRAINS)
    """Which of them."""
    seeds: int = 3
    """Walks, noise and sensors on each terrain."""
    sources: tuple[str, ...] = ()
    """Which sources (default: all)."""
    frames: int = 16
    """Views of a capture, 320 x 240."""
    seconds: float = float("inf")
    """Stop before a new capture after so long."""
    fresh: bool = False
    """Forget earlier rows."""


def main(options: Options) -> None:
    """Run what is missing, one capture after the other, and print the table of what there is."""
    store = open_store(options.fresh)
    rows = store.rows
    began = time.monotonic()
    for terrain in options.terrains:
        for seed in range(options.seeds):
            there = {
                r["source"] for r in rows if (r["terrain"], r["seed"], r["frames"]) == (terrain, seed, options.frames)
            }
            todo = [s for s in options.sources or SOURCES if s not in there]
            if not todo:
                continue
            if time.monotonic() - began > options.seconds:
                show(rows)
                return
            clock = time.process_time()
            kind, terrain_seed = TERRAINS[terrain]
            capture = make_capture(kind, terrain_seed, seed, options.frames)
            surface = true_surface(capture)
            made = time.process_time() - clock
            with tempfile.TemporaryDirectory() as work:
                for source in todo:
                    clock = time.process_time()
                    found = run(source, capture, Path(work))
                    cpu = time.process_time() - clock
                    row: Row = {"terrain": terrain, "seed": seed, "source": source, "frames": options.frames}
                    row |= {"sensor_scale": capture.sensor_scale, "cpu_seconds": cpu, "render_seconds": made}
                    row |= {"error": found} if isinstance(found, str) else measure(found, surface)
                    store.add(row)
            rows = store.rows
            save(store)
    show(rows)


def true_surface(capture: Any) -> Any:
    """Platforms, obstacles and floor as a surface with normals."""
    solids = [s for s in capture.terrain.solids if s.role != "scenery"]
    offsets = np.cumsum([0] + [len(s.vertices) for s in solids])
    V = np.vstack([s.vertices for s in solids])
    F = np.vstack([s.triangles + o for s, o in zip(solids, offsets[:-1], strict=True)])
    low, high = capture.terrain.bounds + np.array([[-0.3], [0.3]])
    return raycasting_scene(V, F), np.vstack([s.normals() for s in solids]), (low, high)


def measure(found: Any, surface: Any) -> Row:
    """Scale error by registration, and whether the stated interval holds the truth."""
    by_pixel = pixel_similarity(found, surface)
    if isinstance(by_pixel, str):
        return {"error": by_pixel}
    factor, rms = registered_scale(found, surface, by_pixel.T)
    row: Row = {
        "scale": 1 / factor, "scale_error": abs(1 / factor - 1), "rms_m": rms,
        "pixel_scale": 1 / by_pixel.scale, "pixel_error": abs(1 / by_pixel.scale - 1),
    }  # fmt: skip
    if found.interval is not None:
        low, high = found.interval
        row |= {"interval": [low, high], "holds": bool(low <= by_pixel.scale <= high)}
    return row


def pixel_similarity(found: Any, surface: Any) -> Any:
    """The similarity between points and where their pixels say that they should be (only a rendered capture knows), or
    why there is none. It is what an interval has to hold; registration to a surface has errors of its own, which on
    blurred clouds of narrow things are larger than the scale's.
    """
    inside = _inside(found, surface)
    fit = robust_similarity(found.points[inside], found.true[inside], np.ones(inside.sum()))
    if fit is None or fit.error > BROKEN:
        off = "nothing" if fit is None else f"points that are off by {fit.error:.2f} m (median)"
        return f"the scene has not the true shape at any scale: {off} after the best similarity"
    return fit


def _inside(found: Any, surface: Any) -> np.ndarray:
    low, high = surface[2]
    return ((found.true > low) & (found.true < high)).all(1)


def registered_scale(found: Any, surface: Any, start: np.ndarray) -> tuple[float, float]:
    """(factor that makes the scene true, RMS metres): point-to-plane registration by a similarity, as the paper's.

    It starts from the right place and then only knows the surface. Steep faces are rare and hold the horizontal scale:
    floor, tops and sides of each direction count alike.
    """
    import open3d as o3d

    scene, normals, (low, _) = surface
    T, P = start, found.points[_inside(found, surface)]
    P = P[np.random.default_rng(0).permutation(len(P))[:POINTS]]
    for reach in REACH:
        for _ in range(6):
            q = P @ T[:3, :3].T + T[:3, 3]
            near = scene.compute_closest_points(o3d.core.Tensor(q.astype(np.float32)))
            N = normals[near["primitive_ids"].numpy().astype(int)]
            offset = q - near["points"].numpy()
            r = (offset * N).sum(1)
            w = np.clip(1 - (np.linalg.norm(offset, axis=1) / reach) ** 2, 0, 1) ** 2
            kind = np.where(N[:, 2] > 0.7, (q[:, 2] > low[2] + 0.1).astype(int), 2 + _quarter(N))
            count = np.bincount(kind, w, minlength=6)
            w = w / np.maximum(count[kind], 0.02 * count.sum())
            c = (w[:, None] * q).sum(0) / w.sum()
            J = np.column_stack([np.cross(q - c, N), N, ((q - c) * N).sum(1)])
            x = -np.linalg.solve((J * w[:, None]).T @ J + 1e-12 * np.eye(7), J.T @ (w * r))
            T = make_T(t=c) @ make_T((1 + x[6]) * exp_so3(x[:3]), x[3:6]) @ make_T(t=-c) @ T
    return float(np.cbrt(np.linalg.det(T[:3, :3]))), float(np.sqrt((w * r**2).sum() / w.sum()))


def _quarter(N: np.ndarray) -> np.ndarray:
    return (np.arctan2(N[:, 1], N[:, 0]) // (np.pi / 2) + 2).astype(int) % 4


def open_store(fresh: bool = False) -> Store:
    """Rows of earlier calls; those of before errors were also measured by pixels are measured again."""
    store = Store(RESULTS, ("terrain", "seed", "source", "frames"))
    store.rows = [r for r in store.rows if not fresh and ("pixel_error" in r or "error" in r)]
    return store


def save(store: Store) -> None:
    """All rows, what they say together, and what they were measured on."""
    from benchmarks.scenes import scale_sources as s

    noise = {
        "sensor_scale_sigma": s.SENSOR_SCALE, "tracker_m_rad": s.TRACKER,
        "lidar_noise_drift_scale": [s.LIDAR_NOISE, s.LIDAR_DRIFT, s.LIDAR_SCALE],
        "phone_noise_drift_scale": [s.PHONE_NOISE, s.PHONE_DRIFT, s.PHONE_SCALE],
    }  # fmt: skip
    store.facts = {
        "what": "rendered captures; rows called simulated come from stand-ins, not from a product",
        "noise": noise, "paper": PAPER, "bar": BAR, "summary": summary(store.rows),
    }  # fmt: skip
    store.save()


def summary(rows: list[Row]) -> dict[str, Row]:
    """Source -> mean, worst, coverage and cost over its rows."""
    out: dict[str, Row] = {}
    for source in dict.fromkeys(r["source"] for r in rows):
        mine = [r for r in rows if r["source"] == source]
        errors = [r["scale_error"] for r in mine if "scale_error" in r]
        by_pixel = [r["pixel_error"] for r in mine if "pixel_error" in r]
        held = [r["holds"] for r in mine if "holds" in r]
        out[source] = {
            "captures": len(mine),
            "failed": sum("error" in r for r in mine),
            "mean": float(np.mean(errors)) if errors else None,
            "worst": float(np.max(errors)) if errors else None,
            "pixel_mean": float(np.mean(by_pixel)) if by_pixel else None,
            "pixel_worst": float(np.max(by_pixel)) if by_pixel else None,
            "coverage": float(np.mean(held)) if held else None,
            "cpu_seconds": float(np.mean([r["cpu_seconds"] for r in mine])),
        }
    return out


def show(rows: list[Row]) -> None:
    """One line a source: all terrains together, then Stake1 and Narrow1 beside the paper's."""
    print(
        "absolute relative scale error, by registration to the true mesh and by known pixels; holds: the 90 % interval"
    )
    heads = ("mean", "worst", "px mean", "px wrst")
    print(f"{'source':<33} {'n':>3} {'fail':>4} {' '.join(f'{h:>7}' for h in heads)} {'holds':>6}   Stake1  Narrow1")
    for source, s in summary(rows).items():
        pair = [np.mean([r["scale_error"] for r in rows if r["source"] == source and r["terrain"] == t
                         and "scale_error" in r] or [np.nan]) for t in PAPER]  # fmt: skip
        keys = ("mean", "worst", "pixel_mean", "pixel_worst")
        cells = [f"{s[k]:7.4f}" if s[k] is not None else "      -" for k in keys]
        held = f"{s['coverage']:6.0%}" if s["coverage"] is not None else "     -"
        tail = "  ".join(f"{v:7.4f}" for v in pair)
        print(f"{source:<33} {s['captures']:>3} {s['failed']:>4} {' '.join(cells)} {held}  {tail}")
    print("\nthe paper's own figures (its terrains, its sensors):")
    for name in PAPER["Stake1"]:
        print(f"{name:<34} {'':>47} {PAPER['Stake1'][name]:7.3f}  {PAPER['Narrow1'][name]:7.3f}")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
