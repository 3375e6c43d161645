"""How good are reconstructions, what do they cost, and how do others do on the same frames?

    python benchmarks/scenes/reconstruct.py  the three rendered captures, two real ones, two peers
    python benchmarks/scenes/reconstruct.py --captures stake_a --no-real
    python benchmarks/scenes/reconstruct.py --frames 60 240 960     cost against the number of frames (half an hour)

Captures come from REALSIM_SHARED (default ../shared); `score.py` there measures every mesh. They are not part of this
repository; `--frames` renders its own. Each run has a process of its own, one after the other, so that times and peak
memory are its own. Every figure goes to benchmarks/results/ as soon as it is there; what failed is only printed.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
SHARED = Path(os.environ.get("REALSIM_SHARED", ROOT.parent / "shared"))
RESULTS = ROOT / "benchmarks" / "results"
MODES = {"given": "given", "hidden": "estimate"}
"""What is done to a capture's poses -> how realsim is told."""

from benchmarks.store import Row, Store  # noqa: E402  (the path above)


@dataclass(frozen=True)
class Options:
    captures: tuple[str, ...] = ("stake_a", "narrow_a", "mixed_a")
    """Rendered captures of REALSIM_SHARED/captures; none skips them."""
    poses: tuple[str, ...] = ("given", "hidden")
    """With the capture's poses, without them, or both."""
    peers: bool = True
    """Run Open3D's steps and plain TSDF with true poses beside it."""
    real: bool = True
    """Run the real captures as well."""
    frames: tuple[int, ...] = ()
    """Measure cost on synthetic captures of these lengths instead of everything else."""
    keep: Path | None = None
    """Keep the scenes in this folder."""


def main(options: Options) -> None:
    """Run what was asked for; every row is stored as soon as it is measured, the tables are printed at the end."""
    with tempfile.TemporaryDirectory() as temporary:
        work = options.keep or Path(temporary)
        if options.frames:
            store = Store(RESULTS / "reconstruct_scaling.json", ("frames", "poses"))
            rows = [store.add(row) for row in scaling(options, work)]
            show(
                rows,
                ("frames", "poses", "seconds", "cpu_seconds", "peak_mb", "cpu_s_a_frame", "points", "align", "mesh"),
            )
            return
        absent = [str(path) for path in needed(options) if not path.exists()]
        if absent:
            sys.exit(f"no {', '.join(absent)}: set REALSIM_SHARED to the folder of the captures, or use --frames")
        store = Store(RESULTS / "reconstruct.json", ("capture", "method"))
        rows = [_kept(store, row) for name in options.captures for row in rendered(name, options, work)]
        if rows:
            show(rows, _COLUMNS)
            _show_ratios(rows)
        for run in (boxes, stairs) if options.real else ():
            row = _kept(store, run(work))
            print("\n".join(f"  {k:<28} {_text(v)}" for k, v in row.items() if k != "stages"), end="\n\n")
        print(*readme_table(store.rows), "", f"written: {store.path}", sep="\n")


def needed(options: Options) -> list[Path]:
    """Folders and files of REALSIM_SHARED that a run reads."""
    rendered = [SHARED / "captures" / name for name in options.captures]
    real = [SHARED / "real_captures" / name for name in ("realsense_boxes_floor", "pcl_kinect_stairs")]
    return [*rendered, *([SHARED / "captures" / "score.py"] if rendered else []), *(real if options.real else [])]


def _kept(store: Store, row: Row) -> Row:
    """A failure is no figure: it does not take the place of one."""
    return row if {"error", "score_error"} & set(row) else store.add(row)


NAMES = {"stake_a": "stakes", "narrow_a": "narrow beams", "mixed_a": "mixed"}
"""Rendered capture -> what the README calls it."""


def readme_table(rows: list[Row]) -> list[str]:
    """The README's table in Markdown: a line a capture and mode, and the worst of plain TSDF."""
    found = {(r["capture"], r["method"]): r for r in rows if r["capture"] in NAMES}
    lines = [
        _readme_line(f"{NAMES[name]}, {mode}", [found[name, f"realsim, poses {mode}"]])
        for mode in MODES
        for name in NAMES
        if (name, f"realsim, poses {mode}") in found
    ]
    plain = [found[name, "tsdf, true poses"] for name in NAMES if (name, "tsdf, true poses") in found]
    if plain:
        lines.append(_readme_line(f"plain 1 cm TSDF with the true poses, worst of {len(plain)}", plain))
    return lines


def _readme_line(name: str, rows: list[Row]) -> str:
    high = {
        k: max(r[k] for r in rows) for k in ("scale_error", "tilt_deg", "yaw_deg", "origin_mm", "delivered_tops_mm")
    }
    low = {k: min(r[k] for r in rows) for k in ("f1", "f2")}
    return (
        f"| {name} | {100 * high['scale_error']:.2f} % | {high['tilt_deg']:.2f}° | {high['yaw_deg']:.2f}° "
        f"| {high['origin_mm']:.1f} mm | {high['delivered_tops_mm']:.1f} mm | {low['f1']:.3f} / {low['f2']:.3f} |"
    )


_COLUMNS = (
    "capture", "method", "scale_error", "tilt_deg", "yaw_deg", "origin_mm", "tops_mm", "delivered_tops_mm", "f1", "f2",
    "f1_rescaled", "f2_rescaled", "chamfer_mm", "seconds", "peak_mb",
)  # fmt: skip


def rendered(name: str, options: Options, work: Path) -> Iterator[Row]:
    """One capture with exact truth: realsim with and without poses, and the peers."""
    from benchmarks.scenes import reconstruct_peers as peers

    source, gt = SHARED / "captures" / name / "capture", SHARED / "captures" / name / "gt"
    for mode in options.poses:
        out = work / f"{name}-{mode}"
        cost = measured(_reconstruct, source, out, MODES[mode])
        yield {"capture": name, "method": f"realsim, poses {mode}", **cost, **score(out, gt)}
    if options.peers:
        truth = read_truth(gt)
        for method, run in (("open3d steps", peers.open3d_steps), ("tsdf, true poses", peers.tsdf_with_true_poses)):
            out = work / f"{name}-{method.split(',')[0].replace(' ', '-')}"
            cost = measured(run, source, out, truth)
            yield {"capture": name, "method": method, **cost, **score(out, gt)}


def read_truth(gt: Path) -> dict[str, Any]:
    """Poses and frame of the truth, JSON-able."""
    poses = json.loads((gt / "gt_poses.json").read_text())
    T = json.loads((gt / "gt.json").read_text())["T_sim_from_world"]
    return {"T_sim_world": T, "T_world_camera": [p["T_world_cam"] for p in poses], "names": [p["index"] for p in poses]}


def score(out: Path, gt: Path) -> Row:
    """What score.py says of a mesh; an empty row with the reason if it says nothing."""
    result = out / "score.json"
    command = [sys.executable, SHARED / "captures" / "score.py", out, gt, "--json", result, "--quiet"]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    if not result.is_file():
        return {"score_error": done.stderr.strip().splitlines()[-1:] or ["no mesh"]}
    s = json.loads(result.read_text())
    rigid, delivered = s["rigid"], s["delivered"]
    return {
        "registered": s["registered"],
        "scale_error": s["abs_rel_scale_error"],
        "tilt_deg": s["gravity_tilt_error_deg"],
        "yaw_deg": abs(s["yaw_error_deg"]),
        "origin_mm": s["origin_error_mm"],
        "tops_mm": rigid.get("obstacles", {}).get("top_abs_dz_median_mm"),
        "delivered_tops_mm": delivered.get("obstacles", {}).get("top_abs_dz_median_mm"),
        "f1": rigid.get("f_score_10mm"),
        "f2": rigid.get("f_score_20mm"),
        # What stays when a wrong scale is taken out: nothing in frames without poses can tell the sensor's own.
        "f1_rescaled": s["similarity"].get("f_score_10mm"),
        "f2_rescaled": s["similarity"].get("f_score_20mm"),
        "chamfer_mm": rigid.get("chamfer_mm"),
    }


def scaling(options: Options, work: Path) -> Iterator[Row]:
    """Cost of synthetic captures of these numbers of frames, every frame used.

    One walk is rendered with the largest number; where another divides it, that many of its frames are taken.
    """
    from realsim.synth import SynthConfig, write_capture

    most, made = max(options.frames), {}
    for frames in sorted(options.frames):
        rendered = most if most % frames == 0 else frames
        if rendered not in made:
            config = SynthConfig(frames=rendered, poses=True)
            made[rendered] = write_capture(work / f"synth-{rendered}", config, overwrite=True).capture
        for mode in options.poses:
            out = work / f"scene-{frames}-{mode}"
            cost = measured(_reconstruct, made[rendered], out, MODES[mode], 0, rendered // frames)
            stages = {s["name"]: s["seconds"] for s in cost.get("stages", [])}
            yield {"frames": frames, "poses": mode, **cost, "cpu_s_a_frame": cost["cpu_seconds"] / frames, **stages}


def boxes(work: Path) -> Row:
    """Four real views of boxes on a floor: the size of a paper sheet, and whether the boxes stand upright."""
    data = SHARED / "real_captures" / "realsense_boxes_floor" / "data"
    source = work / "boxes-frames"
    for kind in ("color", "depth"):
        (source / kind).mkdir(parents=True, exist_ok=True)
        for i in range(4):
            (source / kind / f"{i:06d}.png").write_bytes((data / kind / f"{i:06d}.png").read_bytes())
    (source / "camera_intrinsic.json").write_bytes((data / "cam_params_realsense.json").read_bytes())
    cost = measured(_reconstruct, source, work / "boxes", "estimate")
    if "error" in cost:
        return {"capture": "realsense_boxes_floor", "method": "realsim", **cost}
    report = json.loads((work / "boxes" / "report.json").read_text())
    return {
        "capture": "realsense_boxes_floor",
        "method": "realsim",
        **cost,
        "frames_used": len(report["frames"]["used"]),
        **measured_sheet(source, work / "boxes", report),
        "upright_error_deg": upright_error(work / "boxes" / "mesh.ply"),
    }


LETTER = (0.2159, 0.2794)


def measured_sheet(source: Path, scene: Path, report: dict[str, Any]) -> Row:
    """Sides of the white sheet, corners found in each picture and cast onto the reconstructed surface."""
    import cv2

    from benchmarks.scenes.reconstruct_sheet import find_sheet
    from realsim.synth.errors import read_surface

    surface = read_surface(scene / "mesh.ply")
    k = np.reshape(json.loads((source / "camera_intrinsic.json").read_text())["intrinsic_matrix"], (3, 3)).T
    sides = []
    for name in report["frames"]["used"]:
        picture = cv2.imread(str(source / "color" / f"{name}.png"))
        corners = None if picture is None else find_sheet(picture)
        if corners is None:
            continue
        T = np.asarray(report["cameras"][name])
        rays = np.column_stack([(corners - k[:2, 2]) / [k[0, 0], k[1, 1]], np.ones(4)]) @ T[:3, :3].T
        points = T[:3, 3] + surface.hit(np.tile(T[:3, 3], (4, 1)), rays)[:, None] * rays
        edges = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
        sides.append(sorted([(edges[0] + edges[2]) / 2, (edges[1] + edges[3]) / 2]))
    if not sides:
        return {"sheet_mm": None}
    short, long = np.median(np.array(sides), axis=0)
    error = max(abs(short / LETTER[0] - 1), abs(long / LETTER[1] - 1))
    return {"sheet_mm": [1e3 * short, 1e3 * long], "sheet_error": error, "sheet_views": len(sides)}


def upright_error(mesh_ply: Path) -> float:
    """Degrees by which steep faces lean, area-weighted median."""
    normals, area, _ = _faces(mesh_ply)
    steep = np.abs(normals[:, 2]) < 0.25
    lean = np.degrees(np.arcsin(np.abs(normals[steep, 2])))
    order = np.argsort(lean)
    weight = np.cumsum(area[steep][order])
    return float(lean[order][np.searchsorted(weight, weight[-1] / 2)]) if steep.any() else float("nan")


TREADS = np.array([0.17, 0.36, 0.55, 0.74, 0.92, 1.11, 1.31, 1.51])
"""Metres above the floor, as the description of the data counts them in its five clouds."""
STAIRS = np.array([[-1.15, -2.0, 1.7], [-0.3, 2.0, 2.75]])
"""Where the stairs are in the first camera's frame (x right, z ahead); beside them stand a plant, desk and chairs."""


def stairs(work: Path) -> Row:
    """Five real views of an open staircase: which treads the mesh has, and how regular they are."""
    source = SHARED / "real_captures" / "pcl_kinect_stairs" / "tutorials" / "pairwise"
    cost = measured(_reconstruct, source, work / "stairs", "estimate")
    if "error" in cost:
        return {"capture": "pcl_kinect_stairs", "method": "realsim", **cost}
    report = json.loads((work / "stairs" / "report.json").read_text())
    found = tread_heights(work / "stairs" / "mesh.ply", np.array(report["T_sim_world"]), report["ground_z"])
    off = found - TREADS[np.abs(found[:, None] - TREADS).argmin(1)] if len(found) else found
    near = np.abs(off) < 0.03
    step, floor = np.polyfit(np.round(found[near] / 0.19), found[near], 1) if near.sum() > 2 else (np.nan, np.nan)
    residual = found[near] - floor - step * np.round(found[near] / 0.19)
    return {
        "capture": "pcl_kinect_stairs",
        "method": "realsim",
        **cost,
        "frames_used": len(report["frames"]["used"]),
        "level_heights_m": found.round(3).tolist(),
        "treads_found": len({int(np.abs(TREADS - z).argmin()) for z in found[near]}),
        "treads_in_the_clouds": len(TREADS),
        "heights_that_are_no_tread": int((~near).sum()),
        "tread_rms_mm": 1e3 * float(np.sqrt(np.mean(off[near] ** 2))) if near.any() else None,
        "riser_m": float(step),
        "regularity_rms_mm": 1e3 * float(np.sqrt(np.mean(residual**2))) if len(residual) else None,
    }


def tread_heights(mesh_ply: Path, T_sim_world: np.ndarray, ground_z: float) -> np.ndarray:
    """Heights above the ground at which level surface of the stairs gathers: peaks of its area over height.

    The camera stood 0.83 m high: of the lower treads it saw the tops, of the upper ones the undersides. Both count.
    The world is the first camera's, because the capture gives no poses.
    """
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import find_peaks

    from realsim.core.geometry import invert_T, transform

    normals, area, centres = _faces(mesh_ply)
    seen = transform(invert_T(T_sim_world), centres)
    level = (np.abs(normals[:, 2]) > 0.8) & ((seen > STAIRS[0]) & (seen < STAIRS[1])).all(1)
    edges = np.arange(0.08, 1.8, 0.005)
    profile = gaussian_filter1d(np.histogram(centres[level, 2] - ground_z, edges, weights=area[level])[0], 3)
    peaks, _ = find_peaks(profile, prominence=0.001, distance=18)
    return (edges[peaks] + edges[peaks + 1]) / 2


def _faces(mesh_ply: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from realsim.synth.errors import read_surface

    s = read_surface(mesh_ply)
    t = s.vertices[s.triangles]
    n = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    length = np.maximum(np.linalg.norm(n, axis=1), 1e-15)
    return n / length[:, None], length / 2, t.mean(1)


def measured(function: Callable[..., Row], *args: Any) -> Row:
    """Run in a fresh process: its result, wall time and peak resident memory; an error is a row as well."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            return pool.submit(_timed, function, args).result()
        except Exception as error:  # one failure must not lose the figures of the others
            nothing = dict.fromkeys(("seconds", "cpu_seconds", "peak_mb"), float("nan"))
            return nothing | {"error": f"{type(error).__name__}: {error}"}


def _timed(function: Callable[..., Row], args: tuple[Any, ...]) -> Row:
    from realsim.pipeline import peak_memory_mb

    began, cpu = time.perf_counter(), time.process_time()
    row = function(*args)
    spent = {"seconds": time.perf_counter() - began, "cpu_seconds": time.process_time() - cpu}
    return {**spent, "peak_mb": peak_memory_mb(), **row}


def _reconstruct(source: Path, out: Path, poses: str, max_frames: int | None = None, every: int = 1) -> Row:
    from dataclasses import replace

    from realsim.pipeline import ReconstructConfig, reconstruct

    config = ReconstructConfig(overwrite=True, no_cache=True)
    config = replace(config, points=replace(config.points, poses=poses))
    # Poses that are estimated beside given ones still lend their metre: hidden means that nobody reads them.
    reading = replace(config.capture, every=every, ignore_poses=poses == "estimate")
    if max_frames is not None:
        reading = replace(reading, max_frames=max_frames)
    result = reconstruct(source, out, replace(config, capture=reading))
    return {"stages": [{"name": s.name, "seconds": s.seconds, "peak_mb": s.peak_mb} for s in result.stages]}


def show(rows: list[Row], columns: tuple[str, ...]) -> None:
    """A plain table; what failed is named below it."""
    cells = [[_text(row.get(c)) for c in columns] for row in rows]
    widths = [max(len(c), *(len(r[i]) for r in cells)) for i, c in enumerate(columns)]
    for line in [list(columns), *cells]:
        print("  ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)).rstrip())
    for row in rows:
        if "error" in row:
            print(f"{row.get('frames', row.get('capture'))} {row.get('method', '')}: {row['error']}")
        if "stages" in row:
            stages = ", ".join(f"{s['name']} {s['seconds']:.1f} s {s['peak_mb']:.0f} MB" for s in row["stages"])
            print(f"{row.get('frames', row.get('capture'))} {row.get('method', '')}: {stages}")
    print()


def _show_ratios(rows: list[Row]) -> None:
    """Time of realsim over that of Open3D's steps, same capture, same run."""
    peers = {r["capture"]: r["seconds"] for r in rows if r["method"] == "open3d steps"}
    for row in rows:
        if row["method"].startswith("realsim") and row["capture"] in peers:
            print(f"{row['capture']} {row['method']}: {row['seconds'] / peers[row['capture']]:.2f} x open3d steps")
    print()


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4f}" if abs(value) < 1 else f"{value:.1f}"
    if isinstance(value, (list, tuple)):
        return " ".join(_text(v) for v in value)
    return "-" if value is None else str(value)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
