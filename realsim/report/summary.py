"""report.json: every figure of a reconstruction, JSON-able."""

from __future__ import annotations

import platform as machine
import shlex
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from realsim import __version__
from realsim.core.types import Reconstruction
from realsim.report import page
from realsim.report.verdict import Judgement, dropped_frames, scale_of

_PACKAGES = ("numpy", "scipy", "open3d", "opencv-contrib-python-headless", "trimesh", "pymeshlab", "mujoco")


@dataclass(frozen=True)
class Made:
    """When and how a report was made."""

    date: str
    """To the minute, UTC."""
    command: str
    """How the program was started, as one would type it."""

    @classmethod
    def now(cls) -> Made:
        """By this process, at this time."""
        program = Path(sys.argv[0]).name if sys.argv else ""
        start = ["python", "-m", "realsim"] if program == "__main__.py" else [program]
        return cls(page.now(), shlex.join([*start, *sys.argv[1:]]))


def summary(result: Reconstruction, judgement: Judgement, made: Made) -> dict[str, Any]:
    """The content of report.json. Lengths in metres, simulation frame unless a name says otherwise."""
    aligned, mesh = result.aligned, result.mesh
    metric, points = aligned.metric, result.points
    start, goal = aligned.platform("start"), aligned.platform("goal")
    return {
        "verdict": judgement.as_dict(),
        "made": {"date": made.date, "command": made.command},
        "source": {"name": result.source.source.name, "layout": result.source.layout},
        "T_sim_world": aligned.T_sim_world,
        "world": "scan" if metric is None else "capture" if metric.world_is_capture else "chosen by the backend",
        "scale": _scale(result),
        "gravity": _fields(aligned.gravity, "normal_world tilt_sigma_deg inlier_rms_m inliers method"),
        "ground_z": aligned.ground_z,
        "start": None if start is None else _fields(start, _PLATFORM),
        "goal": None if goal is None else _fields(goal, _PLATFORM),
        "platforms": [_fields(p, _PLATFORM) for p in aligned.platforms],
        "bounds": aligned.bounds,
        "cropped": list(aligned.cropped),
        "frames": {
            "used": [] if metric is None else [f.name for f in metric.frames],
            "dropped": [{"name": n, "stage": s, "reason": r} for n, s, r in dropped_frames(result)],
        },
        "cameras": {} if metric is None else {f.name: aligned.T_sim_camera(i) for i, f in enumerate(metric.frames)},
        "points": None if points is None else _fields(points, _POINTS) | {"statistics": dict(points.statistics)},
        "mesh": {
            "method": mesh.method,
            "resolution_m": mesh.resolution,
            "noise_m": mesh.noise_m,
            "invented_triangles": int(np.count_nonzero(mesh.invented)),
            **vars(mesh.quality),
            "residuals": [{"frame": r.name, "median_abs_m": r.median_abs_m} for r in mesh.residuals],
        },
        "contact": dict(result.scene.contact),
        "checks": dict(result.scene.checks),
        "stages": [vars(s) for s in result.stages],
        "assumptions": [*result.source.assumptions, *aligned.assumptions],
        "warnings": list(result.warnings),
        "changes": None if result.changes is None else dict(result.changes),
        "modes": [vars(m) for m in result.modes],
        "statistics": {"align": dict(aligned.statistics), "mesh": dict(mesh.statistics)},
        "config": dict(result.config),
        "seed": result.seed,
        "versions": versions(),
    }


_PLATFORM = "role centroid size yaw area inferred"
_POINTS = "backend pose_sigma_m depth_gain depth_gain_sigma metric_claim"


def _fields(value: Any, names: str) -> dict[str, Any]:
    """Some attributes by name."""
    return {name: getattr(value, name) for name in names.split()}


def _scale(result: Reconstruction) -> dict[str, Any]:
    estimate = scale_of(result)
    if estimate is None:
        return {"value": 1.0, "ci90": [1.0, 1.0], "per_frame_spread": 0.0, "method": "unit of the scan, as given"}
    assert result.aligned.metric is not None
    found = _fields(estimate, "value ci90 per_frame_spread method per_frame")
    return found | {"depth_gain": result.aligned.metric.depth_gain}


def versions() -> dict[str, str]:
    """Versions of realsim, Python and the packages that decide the result."""
    out = {"realsim": __version__, "python": machine.python_version()}
    for name in _PACKAGES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            continue
    return out
