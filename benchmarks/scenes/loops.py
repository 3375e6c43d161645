"""Is one place taken for another that looks like it, and are real loops closed? Fifty rendered places, poses hidden.

    python benchmarks/scenes/loops.py                       all fifty; places that are stored are not measured again
    python benchmarks/scenes/loops.py --only stairwell-back --again
    python benchmarks/scenes/loops.py --keep /tmp/places    rendered captures stay there and are used again

25 places repeat and are walked through once: corridors with equal doors, three sides of a ring of corridors,
stairwells, rows of equal stakes; in every second one some frames are missing in the middle, so that nothing joins its
halves. 25 come back to where they were: the same four kinds, and walks around a terrain, two of them in random order.

A link is wrong if it is off by more than 0.3 m. A place is wrong if any link that was believed is, or any delivered
pose relative to the frames before and after it, or the trajectory. A loop is kept if a link between its two visits was
believed, and frames of both visits that share surface lie within 30 mm of where they are to each other.
"""

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.store import Row, Store  # noqa: E402  (the path above)
from realsim import capture  # noqa: E402
from realsim.capture.config import CaptureConfig  # noqa: E402
from realsim.core.errors import PoseError  # noqa: E402
from realsim.core.geometry import invert_T  # noqa: E402
from realsim.feedforward.rgbd.estimate import estimate  # noqa: E402
from realsim.feedforward.rgbd.features import Evidence  # noqa: E402
from realsim.feedforward.rgbd.overlap import overlap  # noqa: E402
from realsim.synth.capture import write_capture  # noqa: E402
from realsim.synth.config import SynthConfig  # noqa: E402

FALSE_M = 0.3
"""A link that is off by more than this joins two places that are not one."""

CLOSED_M = 0.03
"""Frames of two visits that are off from each other by less belong to a closed loop."""
AWAY_M = 3.0
"""Metres of way between two visits of one place."""


@dataclass(frozen=True)
class Case:
    """One place and the way through it."""

    terrain: str
    back: bool
    seed: int
    frames: int
    gap: int = 0
    shuffled: bool = False

    @property
    def name(self) -> str:
        way = "back" if self.back else "gap" if self.gap else "once"
        return f"{self.terrain}-{'shuffled' if self.shuffled else way}-{self.seed}"


def cases() -> Iterator[Case]:
    """The fifty. A step is 0.4 m of way, along stakes and on stairs that are climbed twice 0.3 m."""
    # A gap of exactly one flight or bay would look as if nothing were missing: no frame could tell.
    once = {"corridor": (42, 8, 7), "ring": (40, 8, 6), "stairwell": (40, 5, 6), "stake_row": (24, 6, 6)}
    for terrain, (frames, gap, count) in once.items():
        for seed in range(count):
            yield Case(terrain, False, seed, frames, gap=gap * (seed % 2))
    back = {"corridor": (60, 5), "ring": (64, 5), "stairwell": (84, 5), "stake_row": (48, 5), "mixed": (48, 5)}
    for terrain, (frames, count) in back.items():
        for seed in range(100, 100 + count):
            yield Case(terrain, True, seed, frames, shuffled=terrain == "mixed" and seed >= 103)


@dataclass(frozen=True)
class Options:
    only: str = ""
    """Places whose name contains this."""
    again: bool = False
    """Measure also what is stored."""
    width: int = 320
    """Pixels; 640 is what sensors have, and four times slower to render."""
    keep: Path | None = None
    """Folder of the rendered captures."""


def main(options: Options) -> None:
    """Print and store every row as soon as it is measured, then the table."""
    store = Store(ROOT / "benchmarks" / "results" / "loops.json", ("place",))
    with tempfile.TemporaryDirectory() as temporary:
        for case in cases():
            if options.only not in case.name or (store.get(place=case.name) and not options.again):
                continue
            row = store.add(measured(case, rendered(case, options, options.keep or Path(temporary))))
            print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
    print(*table(store.rows), sep="\n")


def rendered(case: Case, options: Options, folder: Path) -> Path:
    """The capture of a case; one that is there is taken as it is."""
    out = folder / f"{case.name}-{options.width}"
    if (out / "truth").is_dir():
        return out / "capture"
    config = SynthConfig(
        case.terrain,
        frames=case.frames,
        width=options.width,
        seed=case.seed,
        poses=True,
        both_sides=case.back,
        once=not case.back,
        gap=case.gap,
        depth_scale=1.0,
    )
    return write_capture(out, config, overwrite=True).capture


def measured(case: Case, source: Path) -> Row:
    """Figures of one place."""
    frames: Any = capture.read(source, CaptureConfig(keep_blurred=True, max_frames=0))
    order = np.arange(len(frames))
    if case.shuffled:
        order = np.random.default_rng(case.seed).permutation(order)
    truth = np.stack([frames.frames[i].T_world_camera for i in order])
    views = Evidence.of([frames.frames[i] for i in order]).views
    again = revisits(views, truth, order)
    about = {"place": case.name, "kind": case.terrain, "loop": case.back, "gap": case.gap, "frames": len(views)}
    began = time.process_time()
    try:
        found = estimate(views, 0)
    except PoseError as error:
        return {**about, "used": 0, "wrong": False, "kept": False, "said": str(error)}
    spent = time.process_time() - began
    used = list(found.used)
    T, true = found.T_world_camera, truth[used]
    far = [e for e in found.links if apart(e.i, e.j, truth, order)]
    bad = [e for e in found.links if off(e.T_i_j, truth[e.i], truth[e.j]) > FALSE_M]
    at = {v: k for k, v in enumerate(used)}
    both = [(at[i], at[j]) for i, j in again if i in at and j in at]
    errors = [motion_error(T[a], T[b], true[a], true[b]) for a, b in both]
    in_order = np.argsort(order[used])
    steps = [motion_error(T[a], T[b], true[a], true[b]) for a, b in pairwise(in_order)]
    trajectory = ate(T, true)
    wrong = bool(bad) or max(steps, default=0.0) > FALSE_M or trajectory > FALSE_M
    gap = float(np.median(errors)) if errors else None
    return {
        **about,
        "used": len(used),
        "parts": found.statistics["parts"],
        "revisits": len(again),
        "revisits_placed": len(both),
        "loop_links": len(far) - sum(e in far for e in bad),
        "wrong_links": len(bad),
        "worst_step_mm": 1e3 * max(steps, default=0.0),
        "ate_mm": 1e3 * trajectory,
        "loop_mm": None if gap is None else 1e3 * gap,
        "wrong": wrong,
        "kept": case.back and not wrong and gap is not None and gap < CLOSED_M and len(far) > len(bad),
        "cpu_s": spent,
        "said": " / ".join(found.warnings) or "-",
    }


def revisits(views: Sequence[Any], truth: np.ndarray, order: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of frames of two visits that share surface, by the true poses."""
    pairs = [(i, j) for j in range(len(views)) for i in range(j) if apart(i, j, truth, order)]
    near = [(i, j) for i, j in pairs if np.linalg.norm(truth[i, :3, 3] - truth[j, :3, 3]) < 3.0]
    return [p for p in near if overlap(views[p[0]], views[p[1]], invert_T(truth[p[0]]) @ truth[p[1]], 4).fraction > 0.2]


def apart(i: int, j: int, truth: np.ndarray, order: np.ndarray) -> bool:
    """Whether the camera went away between two frames and came back."""
    centres = truth[np.argsort(order), :3, 3]
    a, b = sorted((int(order[i]), int(order[j])))
    way = float(np.linalg.norm(np.diff(centres[a : b + 1], axis=0), axis=1).sum())
    return way > AWAY_M and bool(np.linalg.norm(centres[a] - centres[b]) < way / 3)


def off(T_i_j: np.ndarray, T_i: np.ndarray, T_j: np.ndarray) -> float:
    """Metres by which a motion is off from that of true poses."""
    return float(np.linalg.norm((invert_T(T_i_j) @ invert_T(T_i) @ T_j)[:3, 3]))


def motion_error(a: np.ndarray, b: np.ndarray, true_a: np.ndarray, true_b: np.ndarray) -> float:
    """Metres by which frame b is off as frame a sees it."""
    return off(invert_T(a) @ b, true_a, true_b)


def table(rows: Sequence[Row]) -> list[str]:
    """A line for each kind of place in Markdown."""
    lines = [
        "| place | way | places | wrong | loops kept | frames placed | in pieces, reported | trajectory, worst |",
        "|---|---|---|---|---|---|---|---|",
    ]
    stored = {row["place"]: row for row in rows}
    groups: dict[tuple[str, str], list[Row]] = {}
    for case in cases():
        if case.name not in stored:
            continue
        row = stored[case.name]
        way = "random order" if case.shuffled else "back" if case.back else "once, a gap" if case.gap else "once"
        groups.setdefault((case.terrain, way), []).append(row)
    return lines + [_line(name, way, group) for (name, way), group in groups.items()] + [_line("all", "", list(rows))]


def _line(name: str, way: str, rows: Sequence[Row]) -> str:
    loops = [r for r in rows if r["loop"]]
    cut = [r for r in rows if len(r.get("parts", ())) > 1]
    kept = f"{sum(r['kept'] for r in loops)} of {len(loops)}" if loops else "-"
    said = f"{len(cut)}, {sum(r['said'] != '-' for r in cut)}"
    placed = f"{sum(r['used'] for r in rows)} of {sum(r['frames'] for r in rows)}"
    worst = max((r.get("ate_mm", 0.0) for r in rows), default=0.0)
    return (
        f"| {name.replace('_', ' ')} | {way} | {len(rows)} | {sum(r['wrong'] for r in rows)} | {kept} | {placed} "
        f"| {said} | {worst:.0f} mm |"
    )


def ate(found: np.ndarray, truth: np.ndarray) -> float:
    """RMS distance of camera centres after the best rigid motion (Sturm et al. 2012), metres."""
    a, b = found[:, :3, 3].mean(0), truth[:, :3, 3].mean(0)
    U, _, Vt = np.linalg.svd((truth[:, :3, 3] - b).T @ (found[:, :3, 3] - a))
    R = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return float(np.sqrt((((found[:, :3, 3] - a) @ R.T - truth[:, :3, 3] + b) ** 2).sum(1).mean()))


if __name__ == "__main__":
    main(tyro.cli(Options))
