"""Captures that real sensors and apps wrote: what becomes of them, beside the little truth that they come with.

    python benchmarks/scenes/real_captures.py                     all of them, in REALSIM_SHARED/real_captures
    python benchmarks/scenes/real_captures.py --names chair room

Each is reconstructed by the command, in a process of its own. What `known` is comes from the SOURCE.txt beside each
capture; figures under `found` are set against it. There is no exact truth: see `benchmarks/scenes/reconstruct.py` for
that."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import mujoco  # noqa: E402
import trimesh  # noqa: E402

from benchmarks.store import Row, Store  # noqa: E402  (the path above)
from realsim import capture  # noqa: E402
from realsim.capture.config import CaptureConfig  # noqa: E402
from realsim.export.contact.probe import BALL, BALL_RADIUS, SimTouch  # noqa: E402

SHARED = Path(os.environ.get("REALSIM_SHARED", ROOT.parent / "shared")) / "real_captures"
TREADS = (0.17, 0.36, 0.55, 0.74, 0.92, 1.11, 1.31, 1.51)
"""Heights of the staircase's level surfaces above the floor, metres, to 0.02 to 0.04."""
SLAMBOOK = {"fx": 518.0, "fy": 519.0, "cx": 325.5, "cy": 253.5, "width": 640, "height": 480}


@dataclass(frozen=True)
class Case:
    """One capture and how it is reconstructed."""

    source: str
    known: str
    """What is known of it from elsewhere."""
    found: Callable[[Path, Path, dict[str, Any]], str]
    """(source, scene, report) -> the same as it came out."""
    options: tuple[str, ...] = ()


@dataclass(frozen=True)
class Options:
    names: tuple[str, ...] = ()
    """Cases; all if not given."""
    keep: Path | None = None
    """Where the scenes stay, to be looked at."""


def main(options: Options) -> None:
    """Print and store every row as soon as it is measured."""
    store = Store(ROOT / "benchmarks" / "results" / "real_captures.json", ("capture",))
    with tempfile.TemporaryDirectory() as work:
        for name in options.names or CASES:
            row = measured(name, CASES[name], Path(work), (options.keep or Path(work)) / name)
            store.add(row)
            print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)


def measured(name: str, case: Case, work: Path, scene: Path) -> Row:
    """One row."""
    source = SHARED / case.source
    if name == "slambook":  # has no file with its camera, which the book prints
        copy = work / f"{name}-capture"
        copy.mkdir()
        for part in ("color", "depth"):
            (copy / part).symlink_to(source / part)
        (copy / "intrinsics.json").write_text(json.dumps(SLAMBOOK))
        source = copy
    log = work / f"{name}.txt"
    command = [sys.executable, "-m", "realsim", "reconstruct", str(source), "--out", str(scene), "--no-cache"]
    with log.open("w") as out:
        run = subprocess.Popen(
            [*command, "--overwrite", *case.options],
            stdout=out,
            stderr=out,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        _, status, used = os.wait4(run.pid, 0)
    run.returncode = os.waitstatus_to_exitcode(status)
    row: Row = {"capture": name, "cpu_s": used.ru_utime + used.ru_stime, "peak_gb": used.ru_maxrss / 1e6}
    if run.returncode:
        return row | {"verdict": "refused", "said": log.read_text()[-500:], "known": case.known}
    report = json.loads((scene / "report.json").read_text())
    contact, frames = report["contact"], report["frames"]
    return row | {
        "frames": len(frames["used"]),
        "dropped": len(frames["dropped"]),
        "verdict": report["verdict"]["level"],
        "reasons": report["verdict"]["reasons"],
        "platforms": len(report["platforms"]),
        "goal": report["goal"] is not None,
        "representation": contact["representation"],
        "median_mm": contact["median_mm"],
        "p95_mm": contact["p95_mm"],
        "sides_stopped": contact["sides"]["stopped"],
        "heights_off": contact["drop"]["phantom_share"] + contact["drop"]["missing_share"],
        "leaks": contact["leaks"],
        "steps_per_second": contact["steps_per_second"],
        "known": case.known,
        "found": case.found(source, scene, report),
    }


# ---------------------------------------------------------------- what is known


def _treads(_: Path, __: Path, report: dict[str, Any]) -> str:
    heights = sorted(p["size"][2] for p in report["platforms"])
    met = sum(any(abs(h - t) < 0.04 for h in heights) for t in TREADS)
    return f"{met} of 8 among the platforms, at {', '.join(f'{h:.2f}' for h in heights) or 'none'} m"


def _room(_: Path, scene: Path, report: dict[str, Any]) -> str:

    corners, normals = _triangles(scene)
    z = corners.mean(1)[:, 2] - report["ground_z"]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    ceiling = (normals[:, 2] < -0.95) & (z > 2)
    sums, edges = np.histogram(z[ceiling], np.arange(2, 4, 0.02), weights=area[ceiling])
    top = (normals[:, 2] > 0.95) & (z > 0.55) & (z < 0.9)
    below = corners[top].mean(1) - [0, 0, 0.3]
    touch = SimTouch(mujoco.MjSpec.from_file(str(scene / "scene.xml")), BALL)
    free = touch.clearance(below, np.tile([1.0, 0, 0, 0], (len(below), 1))) > -BALL_RADIUS
    share = float((free * area[top]).sum() / area[top].sum())
    return f"{edges[np.argmax(sums)] + 0.01:.2f} m; 30 cm below {area[top].sum():.1f} m² of desks {share:.0%} is free"


def _triangles(scene: Path) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3, 3) corners and (K, 3) unit normals of mesh.ply."""
    mesh = trimesh.load(scene / "mesh.ply", process=False)
    return np.asarray(mesh.triangles), np.asarray(mesh.face_normals)  # type: ignore[union-attr]


def _chair(source: Path, _: Path, report: dict[str, Any]) -> str:
    gain = (report["points"] or {}).get("depth_gain", 1.0)
    tilt = np.degrees(np.arccos(np.clip(np.asarray(report["gravity"]["normal_world"])[1], -1, 1)))
    heights = [p["size"][2] for p in report["platforms"]]
    seat = f"seat at {max(heights):.3f} m" if heights else "the seat is no platform"
    return f"{abs(1 / gain - 1):.1%} named; {seat}; floor {tilt:.2f}° off ARKit's level"


def _chair_estimated(source: Path, scene: Path, report: dict[str, Any]) -> str:
    frames: Any = capture.read(source, CaptureConfig(keep_blurred=True))
    given = {f.name: f.T_world_camera[:3, 3] for f in frames.frames if f.T_world_camera is not None}
    return _ate(report, given) + "; " + _chair(source, scene, report)


def _ate(report: dict[str, Any], given: dict[str, Any]) -> str:
    """RMS distance of camera centres after the best rigid motion, and with the best scale (Umeyama 1991)."""
    names = [n for n in report["cameras"] if n in given]
    a = np.array([np.asarray(report["cameras"][n])[:3, 3] for n in names])
    b = np.array([given[n] for n in names])
    a, b = a - a.mean(0), b - b.mean(0)
    U, s, Vt = np.linalg.svd(b.T @ a)
    D = np.array([1, 1, np.sign(np.linalg.det(U @ Vt))])
    scale = float((s * D).sum() / (a**2).sum())
    R = (U * D) @ Vt
    rigid, similar = (1e3 * np.sqrt(((k * a @ R.T - b) ** 2).sum(1).mean()) for k in (1.0, scale))
    return f"ATE {rigid:.1f} mm, {similar:.1f} mm with scale {scale:.3f}, of {len(names)} frames"


def _slambook(_: Path, __: Path, report: dict[str, Any]) -> str:
    rows = np.loadtxt(SHARED / "slambook_five/data/pose.txt")
    return _ate(report, {str(k + 1): row[:3] for k, row in enumerate(rows)})


def _boxes(_: Path, __: Path, report: dict[str, Any]) -> str:
    return f"{len(report['frames']['used'])} of 10 fit together; the sheet is not measured"


CABINET = np.array([0.793, 0.445, 0.545])
"""Metres: length, depth and height of TUM's fr3/cabinet."""


def _cabinet(source: Path, _: Path, report: dict[str, Any]) -> str:
    frames: Any = capture.read(source, CaptureConfig(keep_blurred=True, max_frames=0))
    given = {f.name: f.T_world_camera[:3, 3] for f in frames.frames}
    sizes = [np.array(p["size"]) for p in report["platforms"]]
    if not sizes:
        return _ate(report, given) + "; the cabinet is no platform"
    size = min(sizes, key=lambda v: np.abs(v - CABINET).max())
    off = " ".join(f"{1e3 * v:+.0f}" for v in size - CABINET)
    return f"{_ate(report, given)}; {' x '.join(f'{v:.3f}' for v in size)} m, off by {off} mm"


CASES = {
    "chair": Case(
        "scannerapp_chair/data",
        "LiDAR and ARKit 4 % apart; seat at about 0.40 m",
        _chair,
    ),
    "chair, no poses": Case(
        "scannerapp_chair/data",
        "ARKit's trajectory; LiDAR and ARKit 4 % apart; seat at about 0.40 m",
        _chair_estimated,
        ("--poses", "estimate"),
    ),
    "stairs": Case("pcl_kinect_stairs/tutorials/pairwise", "8 level surfaces at 0.17 to 1.51 m", _treads),
    "room": Case("pcl_room_lidar/tutorials/room_scan1.pcd", "2.95 m from floor to ceiling", _room, ("--keep", "all")),
    "boxes": Case(
        "realsense_boxes_floor/data", "six of ten views show the same boxes; things were moved between others", _boxes
    ),
    "cabinet": Case("tum_cabinet/data", "TUM fr3/cabinet, motion capture; 0.793 x 0.445 x 0.545 m", _cabinet),
    "cabinet, no poses": Case(
        "tum_cabinet/data",
        "TUM fr3/cabinet, motion capture; 0.793 x 0.445 x 0.545 m",
        _cabinet,
        ("--poses", "estimate"),
    ),
    "slambook": Case("slambook_five/data", "five poses", _slambook),
}


if __name__ == "__main__":
    main(tyro.cli(Options))
