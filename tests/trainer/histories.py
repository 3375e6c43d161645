"""Folders of training runs as the trainer writes them, with curves that are known."""

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

FAMILIES = ("wedges", "stakes", "boxes")
CAUSES = ("ground", "tilt", "collapsed", "stuck", "timeout")
TERMS = ("alive", "linear_velocity", "action_rate", "feet_slide", "energy", "edge_penetration", "heading_error")


def row(iteration: int, pace: float = 1.0, new: bool = True, seed: int = 0) -> dict[str, Any]:
    """A row of an iteration; `new` adds the figures that earlier versions did not log."""
    rng = np.random.default_rng([seed, iteration])
    t = 1 - math.exp(-pace * (iteration + 1) / 300)
    out: dict[str, Any] = {"iteration": iteration}
    out |= {"policy_loss": -0.01 * rng.random(), "value_loss": 0.5 * (1 - t) + 0.01, "entropy": 12 - 6 * t}
    out |= {"kl": 0.01 * (0.7 + 0.6 * rng.random()), "learning_rate": 1e-3 / (1 + iteration / 50), "std": 1 - 0.6 * t}
    out |= {f"env/reward/{term}": (0.06 if k == 0 else -0.01 / k) * t for k, term in enumerate(TERMS[:-1])}
    out |= {f"env/reward/{TERMS[-1]}": 0.0, "env/terrain/level": 6 * t, "env/success": 0.8 * t * t}
    out |= {"env/episode/covered": t, "env/episode/seconds": 4 + 9 * t, "env/physics/diverged": 0.0}
    out |= {"env/physics/overflowed": 3.0 * (iteration + 1)}
    shares = _shares(1 - out["env/success"])
    out |= {f"env/end/{cause}": share for cause, share in shares.items()}
    out |= {"reward": 0.06 * t, "return": 9 * t, "length": 200 + 450 * t, "episodes": float(rng.integers(200, 400))}
    out |= {"collect_s": 0.5, "update_s": 0.25 / pace}
    return out | (_new(iteration, t, rng) if new else {})


def _new(iteration: int, t: float, rng: np.random.Generator) -> dict[str, Any]:
    out: dict[str, Any] = {"std/legs": 1 - 0.7 * t, "std/waist": 1 - 0.5 * t, "std/arms": 1 - 0.4 * t}
    out |= {"std_limit": 1.0 - 0.6 * min(1, iteration / 400), "explained_variance": t, "clip_fraction": 0.2 * (1 - t)}
    out |= {"gradient/policy": 0.5 + rng.random(), "gradient/critic": 20 * (1 - t) + rng.random()}
    out |= {"env/physics/solver_limited": 239.0 * (iteration + 1), "env/episode/waiting": 0.3 * (1 - t)}
    for k, family in enumerate(FAMILIES):
        success = 0.9 * t * t / (k + 1)
        figures = {"success": success, "covered": t / (1 + 0.3 * k), "row": 7 * t / (k + 1)}
        figures["episodes"] = float(rng.integers(20, 90))
        figures |= {f"end/{cause}": share for cause, share in _shares(1 - success).items()}
        out |= {f"env/family/{family}/{name}": value for name, value in figures.items()}
    return out


def _shares(whole: float) -> dict[str, float]:
    return {cause: whole * part for cause, part in zip(CAUSES, (0.5, 0.3, 0.0, 0.15, 0.05), strict=True)}


def write(folder: Path, rows: Iterable[Mapping[str, Any] | str]) -> Path:
    """A run's folder with its history; texts are written as they are, without a line feed."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [r if isinstance(r, str) else json.dumps(r) + "\n" for r in rows]
    (folder / "history.jsonl").write_text("".join(lines))
    return folder


def run(folder: Path, iterations: int, every: int = 0, make: Callable[..., dict[str, Any]] = row, **how: Any) -> Path:
    """A whole run, with evaluations on the way each `every` iterations."""
    rows: list[Mapping[str, Any]] = [{"iteration": 0, "success": 0.0}] if every else []
    for i in range(iterations):
        rows.append(make(i, **how))
        if every and (i + 1) % every == 0:
            rows.append({"iteration": i, "success": rows[-1]["env/success"]})
    return write(folder, rows)


def evaluation(terrain: str = "stakes_0.50_7", trials: int = 100, seed: int = 0) -> dict[str, Any]:
    """What `realsim evaluate --out` writes."""
    rng = np.random.default_rng(seed)
    failures = [
        {
            "trial": i,
            "cause": str(rng.choice(CAUSES[:2])),
            "position": [float(x), float(rng.normal(0, 0.2)), 0.7],
            "seconds": float(x / 0.6),
        }
        for i, x in enumerate(rng.normal(1.8, 0.4, trials // 3))
    ]
    bins: dict[int, dict[str, int]] = {}
    reasons: dict[str, int] = {}
    for f in failures:
        counts = bins.setdefault(int(f["position"][0] // 0.25), {})
        for c in (counts, reasons):
            c[f["cause"]] = c.get(f["cause"], 0) + 1
    where = [{"from_m": 0.25 * k, "to_m": 0.25 * (k + 1)} | bins[k] for k in sorted(bins)]
    won = trials - len(failures)
    result = {
        "terrain": terrain, "geometry": "trained", "trials": trials, "successes": won, "interval": [0.57, 0.75],
        "reasons": reasons, "where": where, "failures": failures, "seconds": 6.5, "covered": 0.8, "overflowed": 0,
        "rate": won / trials,
    }  # fmt: skip
    return {"format": "realsim.evaluation/1", "success": won / trials, "terrains": [result]}
