"""How good are reconstructions, and what do they cost?

    python benchmarks/scenes/reconstruct.py  the three rendered captures
    python benchmarks/scenes/reconstruct.py --captures stake_a

Captures come from REALSIM_SHARED (default ../shared); `score.py` there measures every mesh. They are not part of this
repository. Each run has a process of its own, one after the other, so that times and peak memory are its own. Every
figure goes to benchmarks/results/ as soon as it is there; what failed is only printed.
"""

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

import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
SHARED = Path(os.environ.get("REALSIM_SHARED", ROOT.parent / "shared"))
RESULTS = ROOT / "benchmarks" / "results"
MODES = {"given": "given", "hidden": "estimate"}
"""What is done to a capture's poses -> how realsim is told."""

from dataclasses import replace  # noqa: E402

from benchmarks.store import Row, Store  # noqa: E402  (the path above)
from realsim.pipeline import ReconstructConfig, peak_memory_mb, reconstruct  # noqa: E402


@dataclass(frozen=True)
class Options:
    captures: tuple[str, ...] = ("stake_a", "narrow_a", "mixed_a")
    """Rendered captures of REALSIM_SHARED/captures."""
    poses: tuple[str, ...] = ("given", "hidden")
    """With the capture's poses, without them, or both."""
    keep: Path | None = None
    """Keep the scenes in this folder."""


def main(options: Options) -> None:
    """Run what was requested; every row is stored as soon as it is measured, the tables are printed at the end."""
    with tempfile.TemporaryDirectory() as temporary:
        work = options.keep or Path(temporary)
        absent = [str(path) for path in needed(options) if not path.exists()]
        if absent:
            sys.exit(f"no {', '.join(absent)}: set REALSIM_SHARED to the folder of the captures")
        store = Store(RESULTS / "reconstruct.json", ("capture", "method"))
        rows = [_kept(store, row) for name in options.captures for row in rendered(name, options, work)]
        show(rows, _COLUMNS)
        print(f"written: {store.path}")


def needed(options: Options) -> list[Path]:
    """Folders and files of REALSIM_SHARED that a run reads."""
    return [SHARED / "captures" / name for name in (*options.captures, "score.py")]


def _kept(store: Store, row: Row) -> Row:
    """A failure is no figure: it does not take the place of one."""
    return row if {"error", "score_error"} & set(row) else store.add(row)


NAMES = {"stake_a": "stakes", "narrow_a": "narrow beams", "mixed_a": "mixed"}
"""Rendered capture -> what the README calls it."""


_COLUMNS = (
    "capture", "method", "scale_error", "tilt_deg", "yaw_deg", "origin_mm", "tops_mm", "delivered_tops_mm", "f1", "f2",
    "f1_rescaled", "f2_rescaled", "chamfer_mm", "seconds", "peak_mb",
)  # fmt: skip


def rendered(name: str, options: Options, work: Path) -> Iterator[Row]:
    """One capture with exact truth: with its poses and without."""
    source, gt = SHARED / "captures" / name / "capture", SHARED / "captures" / name / "gt"
    for mode in options.poses:
        out = work / f"{name}-{mode}"
        cost = measured(_reconstruct, source, out, MODES[mode])
        yield {"capture": name, "method": f"realsim, poses {mode}", **cost, **score(out, gt)}


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
    began, cpu = time.perf_counter(), time.process_time()
    row = function(*args)
    spent = {"seconds": time.perf_counter() - began, "cpu_seconds": time.process_time() - cpu}
    return {**spent, "peak_mb": peak_memory_mb(), **row}


def _reconstruct(source: Path, out: Path, poses: str) -> Row:

    config = ReconstructConfig(overwrite=True, no_cache=True)
    config = replace(config, points=replace(config.points, poses=poses))
    # Poses that are estimated beside given ones still lend their metre: hidden means that nobody reads them.
    reading = replace(config.capture, ignore_poses=poses == "estimate")
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


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4f}" if abs(value) < 1 else f"{value:.1f}"
    if isinstance(value, (list, tuple)):
        return " ".join(_text(v) for v in value)
    return "-" if value is None else str(value)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
