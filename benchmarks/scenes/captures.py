"""What captures of the real world go wrong by, on rendered ones with exact truth, before and after.

    python benchmarks/scenes/captures.py                        two seeds of every place, two unregistered Kinects
    python benchmarks/scenes/captures.py --seeds 0 1 2 3 4 5    more of them
    python benchmarks/scenes/captures.py --kinds ring

Places that repeat (corridor, ring, stairwell, stake_row), poses hidden: links between frames far apart that were
believed, how many of them are false, and the error of the trajectory; `all links` is a robust pose graph over every
pair that matches. Kinect (colour not registered to depth, poses that drift by 1 cm): error of the poses and of the
surface's scale, as given, and as delivered; F of the delivered surface beside that of a plain TSDF with given poses.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.store import Row, Store  # noqa: E402  (the path above)

FALSE_M = 0.3
"""A link that is off by more than this joins two places that are not one."""


@dataclass(frozen=True)
class Options:
    seeds: tuple[int, ...] = (0, 1)
    kinds: tuple[str, ...] = ("corridor", "ring", "stairwell", "stake_row", "kinect")
    frames: int = 60
    width: int = 320
    """Pixels; 640 is what sensors have, and four times slower to render."""


def main(options: Options) -> None:
    """Print and store every row as soon as it is measured."""
    store = Store(ROOT / "benchmarks" / "results" / "captures.json", ("kind", "seed", "method"))
    with tempfile.TemporaryDirectory() as work:
        for kind in options.kinds:
            for seed in options.seeds:
                for row in _rows(Path(work) / f"{kind}-{seed}", kind, seed, options):
                    store.add(row)
                    print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()))


def _rows(folder: Path, kind: str, seed: int, options: Options) -> Iterator[Row]:
    from realsim.synth import SynthConfig, write_capture

    size = {"frames": options.frames, "width": options.width, "seed": seed, "poses": True}
    if kind == "kinect":
        made = write_capture(folder, SynthConfig("mixed", sensor="kinect", pose_error=0.01, both_sides=True, **size))
    else:
        made = write_capture(folder, SynthConfig(kind, **size))
    rows = _kinect(made.capture, made.truth) if kind == "kinect" else _place(made.capture)
    surfaces = _surfaces(made.capture, made.truth, folder) if kind == "kinect" else ()
    for row in (*rows, *surfaces):
        yield {"kind": kind, "seed": seed, **row}


def _place(source: Path) -> Iterator[Row]:
    from realsim import capture, feedforward
    from realsim.capture.config import CaptureConfig
    from realsim.feedforward.config import PointsConfig
    from realsim.feedforward.rgbd.estimate import connect
    from realsim.feedforward.rgbd.features import Evidence
    from realsim.feedforward.rgbd.loop_closure import _placed, join

    frames: Any = capture.read(source, CaptureConfig(keep_blurred=True))
    truth = np.stack([f.T_world_camera for f in frames.frames])
    views = Evidence.of(frames.frames).views
    net = connect(views, 0)
    for method, found in (("all links", _placed(len(views), net.edges, [])), ("joined", join(views, net.edges))):
        far = [e for e in found.edges if abs(e.j - e.i) > 4]
        yield {
            "method": method,
            "frames": len(views),
            "used": len(found.used),
            "loops": len(far),
            "false_loops": sum(_off(e, truth) > FALSE_M for e in far),
            "false_neighbours": sum(_off(e, truth) > FALSE_M for e in found.edges if abs(e.j - e.i) <= 4),
            "ate_mm": 1e3 * ate(found.T, truth[found.used]),
        }
    solution = feedforward.solve(frames, PointsConfig(poses="estimate"))
    used = list(solution.used)
    yield {
        "method": "delivered",
        "frames": len(views),
        "used": len(used),
        "ate_mm": 1e3 * ate(solution.T_world_camera, truth[used]),
        "said": " / ".join(solution.warnings) or "-",
    }


def _kinect(source: Path, truth_folder: Path) -> Iterator[Row]:
    from realsim import capture, feedforward
    from realsim.capture.config import CaptureConfig
    from realsim.feedforward.config import PointsConfig
    from realsim.synth.truth import read_truth

    truth = read_truth(truth_folder)[0]
    frames: Any = capture.read(source, CaptureConfig(keep_blurred=True))
    true = np.asarray(truth["T_sim_camera"])
    given = np.stack([f.T_world_camera for f in frames.frames])
    yield {"method": "given", "ate_mm": 1e3 * ate(given, true), "scale_error": 1 - truth["depth_scale"]}
    for poses in ("given", "estimate"):
        found = feedforward.solve(frames, PointsConfig(poses=poses))  # type: ignore[arg-type]
        zoom = float(np.prod([1 + row[0] for row in found.arrays["registration"]]))
        tried = found.statistics.get("held_out", [{}])[-1]
        yield {
            "method": f"realsim, poses {poses}",
            "used": len(found.used),
            "ate_mm": 1e3 * ate(found.T_world_camera, true[list(found.used)]),
            "scale_error": found.depth_gain * truth["depth_scale"] - 1,
            "zoom": zoom,
            "true_zoom": truth["cameras"]["depth"]["fx"] / truth["cameras"]["color"]["fx"],
            "held_out_before_mm": 1e3 * tried.get("before_m", float("nan")),
            "held_out_after_mm": 1e3 * tried.get("after_m", float("nan")),
        }


def _surfaces(source: Path, truth_folder: Path, work: Path) -> Iterator[Row]:
    """The surface of a plain TSDF with the given poses, which is to be beaten, and the one that is delivered."""
    import open3d

    from benchmarks.scenes.reconstruct_peers import fuse
    from realsim import capture
    from realsim.capture.config import CaptureConfig
    from realsim.pipeline import reconstruct
    from realsim.synth.errors import compare
    from realsim.synth.truth import read_truth

    frames: Any = capture.read(source, CaptureConfig(keep_blurred=True))
    given = np.stack([f.T_world_camera for f in frames.frames])
    R, a, b = _laid(given, np.asarray(read_truth(truth_folder)[0]["T_sim_camera"]))
    T_sim_world = np.eye(4)
    T_sim_world[:3, :3], T_sim_world[:3, 3] = R, b - R @ a
    (work / "plain").mkdir()
    open3d.io.write_triangle_mesh(str(work / "plain" / "mesh.ply"), fuse(frames.frames, T_sim_world @ given))
    reconstruct(source, work / "scene")
    for method, scene in (("plain TSDF, poses given", "plain"), ("scene, poses given", "scene")):
        figures = compare(work / scene, truth_folder)
        yield {"method": method, **{k: figures[k] for k in ("f_score_1cm", "f_score_2cm", "tops_mm")}}


def _off(e: Any, truth: np.ndarray) -> float:
    from realsim.core.geometry import invert_T

    return float(np.linalg.norm((invert_T(e.T_i_j) @ invert_T(truth[e.i]) @ truth[e.j])[:3, 3]))


def ate(found: np.ndarray, truth: np.ndarray) -> float:
    """RMS distance of camera centres after the best rigid motion (Sturm et al. 2012), metres."""
    R, a, b = _laid(found, truth)
    return float(np.sqrt((((found[:, :3, 3] - a) @ R.T - truth[:, :3, 3] + b) ** 2).sum(1).mean()))


def _laid(found: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rotation that lays camera centres onto the true ones, middle of the found, middle of the true)."""
    a, b = found[:, :3, 3].mean(0), truth[:, :3, 3].mean(0)
    U, _, Vt = np.linalg.svd((truth[:, :3, 3] - b).T @ (found[:, :3, 3] - a))
    return U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt, a, b


if __name__ == "__main__":
    main(tyro.cli(Options))
