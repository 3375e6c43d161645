"""Frames without poses that are hard to match, with and without the learned matcher.

    python benchmarks/scenes/matching.py                                   everything
    python benchmarks/scenes/matching.py --captures stake_a boxes --kinds "every 8" "blur 15"

Rendered captures (REALSIM_SHARED/captures, exact poses) are thinned to every n-th frame, smeared along a line of some
pixels in a random direction per frame, or darkened: light divided by the figure, then photon noise of 2,000 electrons
at white, read noise of 4 and eight bits. Depth stays as it is. Two real captures come with five and no poses.

A row: frames placed, error of their camera centres after the best rigid motion (ATE), largest error of the motion
between frames that follow each other, wall-clock seconds of the stage, pairs that the learned matcher was asked about
and joined (where it was not asked, the row without it is a copy); with --scenes also the mesh's F-score at 1 cm.
"""

import json
import os
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import trimesh  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

from benchmarks.scenes.loops import ate  # noqa: E402  (the path above)
from benchmarks.scenes.real_captures import SLAMBOOK  # noqa: E402
from benchmarks.scenes.reconstruct import score  # noqa: E402
from benchmarks.store import Row, Store  # noqa: E402
from realsim import align, capture, feedforward, meshing, scale  # noqa: E402
from realsim.align.config import AlignConfig  # noqa: E402
from realsim.capture.config import CaptureConfig  # noqa: E402
from realsim.core.errors import PoseError, RealsimError  # noqa: E402
from realsim.core.geometry import invert_T  # noqa: E402
from realsim.feedforward.config import PointsConfig  # noqa: E402
from realsim.meshing.config import MeshConfig  # noqa: E402
from realsim.scale.config import ScaleConfig  # noqa: E402

SHARED = Path(os.environ.get("REALSIM_SHARED", ROOT.parent / "shared"))
RENDERED = ("stake_a", "narrow_a", "mixed_a")
REAL = {"boxes": "realsense_boxes_floor/data", "slambook": "slambook_five/data"}
KINDS = ("as it is", "every 2", "every 4", "every 8", "blur 9", "blur 15", "blur 25", "dark 30", "dark 100", "dark 300")
WHITE, READ = 2000, 4
"""Electrons of a small sensor at white, and its read noise."""


@dataclass(frozen=True)
class Options:
    captures: tuple[str, ...] = (*REAL, *RENDERED)
    kinds: tuple[str, ...] = KINDS
    """Of the rendered ones."""
    every: int = 6
    """Blurred and dark captures have every n-th frame, so that they take minutes, not hours."""
    scenes: bool = False
    """Also build the scenes and score their meshes (a minute each)."""


def main(options: Options) -> None:
    """Print and store every row as soon as it is measured."""
    store = Store(ROOT / "benchmarks" / "results" / "matching.json", ("capture", "kind", "learned", "frames"))
    for name in options.captures:
        for kind in options.kinds if name in RENDERED else ("as it is",):
            with tempfile.TemporaryDirectory() as work:
                frames = _frames(name, kind, options.every, Path(work))
                row: Row = {}
                for learned in (True, False):
                    if learned or row.get("asked", 1):  # what was not asked about has the same bytes without
                        row, found = _points(frames, name, learned)
                        if found is not None and options.scenes and name in RENDERED:
                            row["f_1cm"] = _f_score(frames, found, name)
                    row = {**row, "capture": name, "kind": kind, "learned": learned}
                    store.add(row)
                    print(
                        "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()),
                        flush=True,
                    )


def _frames(name: str, kind: str, every: int, work: Path) -> Any:
    """The frames of a capture, made harder."""
    if name == "slambook":  # has no file with its camera, which the book prints
        for part in ("color", "depth"):
            (work / part).symlink_to(SHARED / "real_captures" / REAL[name] / part)
        (work / "intrinsics.json").write_text(json.dumps(SLAMBOOK))
        return capture.read(work, CaptureConfig(keep_blurred=True))
    if name in REAL:
        return capture.read(SHARED / "real_captures" / REAL[name], CaptureConfig(keep_blurred=True))
    what, _, size = kind.partition(" ")
    step = int(size) if what == "every" else 1 if what == "as" else every
    found: Any = capture.read(SHARED / "captures" / name / "capture", CaptureConfig(keep_blurred=True, every=step))
    if what in SPOIL:
        spoil = partial(SPOIL[what], float(size))
        frames = tuple(
            replace(f, read_color=partial(_spoiled, f.read_color, spoil, k)) for k, f in enumerate(found.frames)
        )
        return replace(found, frames=frames)
    return found


def _spoiled(read: Any, spoil: Any, k: int) -> Any:
    return spoil(read(), np.random.default_rng(k))


def blurred(length: float, color: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A picture (h, w, 3) smeared over `length` pixels in one direction, in linear light."""
    import cv2

    turn = rng.uniform(0, np.pi)
    along = np.linspace(-length / 2, length / 2, 64)
    half = int(np.ceil(length / 2)) + 1
    kernel, _, _ = np.histogram2d(along * np.sin(turn), along * np.cos(turn), np.arange(-half - 0.5, half + 1))
    light = cv2.filter2D((color / 255.0) ** 2.2, -1, kernel / kernel.sum())
    return np.asarray((np.clip(light, 0, 1) ** (1 / 2.2) * 255).round(), np.uint8)


def darkened(factor: float, color: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A picture with so much less light, not amplified."""
    electrons = rng.poisson((color / 255.0) ** 2.2 / factor * WHITE) + rng.normal(0, READ, color.shape)
    return np.asarray((np.clip(electrons / WHITE, 0, 1) ** (1 / 2.2) * 255).round(), np.uint8)


SPOIL = {"blur": blurred, "dark": darkened}


def _points(frames: Any, name: str, learned: bool) -> tuple[Row, Any]:
    began = time.perf_counter()
    try:
        found = feedforward.solve(frames, PointsConfig(poses="estimate", learned_matches=learned))
    except PoseError as error:
        row = {"frames": len(frames), "placed": 0, "seconds": time.perf_counter() - began}
        return row | {"said": error.render().splitlines()[0]}, None
    row: Row = {
        "frames": len(frames),
        "placed": len(found.used),
        "seconds": time.perf_counter() - began,
        "asked": found.statistics.get("learned_queried", 0),
        "joined": found.statistics.get("learned_pairs", 0),
        "tracks": found.statistics.get("tracks", 0),
    }
    truth = _truth(frames, name)
    if truth is not None and len(found.used) > 2:
        true = truth[list(found.used)]
        row |= {
            "ate_mm": 1e3 * ate(found.T_world_camera, true),
            "worst_step_mm": 1e3 * _worst_step(found.T_world_camera, true),
        }
    return row, found


def _truth(frames: Any, name: str) -> np.ndarray | None:
    """(N, 4, 4)."""
    if name == "slambook":
        rows = np.loadtxt(SHARED / "real_captures" / REAL[name] / "pose.txt")
        T = np.tile(np.eye(4), (len(rows), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = Rotation.from_quat(rows[:, 3:7]).as_matrix(), rows[:, :3]
        return T[[int(f.name) - 1 for f in frames.frames]]
    if name in REAL:
        return None
    return np.stack([f.T_world_camera for f in frames.frames])


def _worst_step(found: np.ndarray, truth: np.ndarray) -> float:
    """Largest error of the motion between frames that follow each other, metres."""
    steps = [invert_T(T[:-1]) @ T[1:] for T in (found, truth)]
    return float(np.linalg.norm((invert_T(steps[0]) @ steps[1])[:, :3, 3], axis=1).max())


def _f_score(frames: Any, solution: Any, name: str) -> float | None:
    """F-score at 1 cm of the mesh without a change of scale, by the score.py beside the captures; None without one."""

    try:
        points = feedforward.pointmaps(frames, solution, PointsConfig(poses="estimate"))
        metric = scale.to_metric(points, ScaleConfig(), frames.up_world, frames.sensor_sigma)
        mesh = meshing.build(align.align(metric, AlignConfig()), MeshConfig())
    except RealsimError as error:
        print(error.render())
        return None
    with tempfile.TemporaryDirectory() as folder:
        trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(Path(folder) / "mesh.ply")
        return score(Path(folder), SHARED / "captures" / name / "gt").get("f1")


if __name__ == "__main__":
    main(tyro.cli(Options))
