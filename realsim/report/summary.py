"""report.json: every figure of a reconstruction, JSON-able."""

from __future__ import annotations

import platform as machine
import shlex
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from realsim import __version__
from realsim.core.types import MeshQuality, Platform, Reconstruction
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
        return cls(f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", shlex.join([*start, *sys.argv[1:]]))


def summary(result: Reconstruction, judgement: Judgement, made: Made) -> dict[str, Any]:
    """The content of report.json. Lengths in metres, simulation frame unless a name says otherwise."""
    aligned, mesh = result.aligned, result.mesh
    metric = aligned.metric
    start, goal = aligned.platform("start"), aligned.platform("goal")
    return {
        "verdict": judgement.as_dict(),
        "made": {"date": made.date, "command": made.command},
        "source": {"name": result.source.source.name, "layout": result.source.layout},
        "T_sim_world": aligned.T_sim_world,
        "world": "scan" if metric is None else "capture" if metric.world_is_capture else "chosen by the backend",
        "scale": _scale(result),
        "gravity": {
            "normal_world": aligned.gravity.normal_world,
            "tilt_sigma_deg": aligned.gravity.tilt_sigma_deg,
            "inlier_rms_m": aligned.gravity.inlier_rms_m,
            "inliers": aligned.gravity.inliers,
            "method": aligned.gravity.method,
        },
        "ground_z": aligned.ground_z,
        "start": None if start is None else _platform(start),
        "goal": None if goal is None else _platform(goal),
        "platforms": [_platform(p) for p in aligned.platforms],
        "bounds": aligned.bounds,
        "cropped": list(aligned.cropped),
        "frames": {
            "used": [] if metric is None else [f.name for f in metric.frames],
            "dropped": [{"name": n, "stage": s, "reason": r} for n, s, r in dropped_frames(result)],
        },
        "cameras": {} if metric is None else {f.name: aligned.T_sim_camera(i) for i, f in enumerate(metric.frames)},
        "points": None if result.points is None else _points(result),
        "mesh": _mesh(result),
        "contact": dict(result.scene.contact),
        "checks": dict(result.scene.checks),
        "stages": [
            {"name": s.name, "seconds": s.seconds, "peak_mb": s.peak_mb, "reused": s.reused} for s in result.stages
        ],
        "assumptions": [*result.source.assumptions, *aligned.assumptions],
        "warnings": list(result.warnings),
        "changes": None if result.changes is None else dict(result.changes),
        "modes": [vars(m) for m in result.modes],
        "statistics": {"align": dict(aligned.statistics), "mesh": dict(mesh.statistics)},
        "config": dict(result.config),
        "seed": result.seed,
        "versions": versions(),
    }


def _scale(result: Reconstruction) -> dict[str, Any]:
    estimate = scale_of(result)
    if estimate is None:
        return {"value": 1.0, "ci90": [1.0, 1.0], "per_frame_spread": 0.0, "method": "unit of the scan, as given"}
    assert result.aligned.metric is not None
    return {
        "value": estimate.value,
        "ci90": list(estimate.ci90),
        "per_frame_spread": estimate.per_frame_spread,
        "method": estimate.method,
        "per_frame": list(estimate.per_frame),
        "depth_gain": result.aligned.metric.depth_gain,
    }


def _platform(p: Platform) -> dict[str, Any]:
    return {
        "role": p.role,
        "centroid": p.centroid,
        "size": p.size,
        "yaw": p.yaw,
        "area": p.area,
        "inferred": p.inferred,
    }


def _points(result: Reconstruction) -> dict[str, Any]:
    points = result.points
    assert points is not None
    return {
        "backend": points.backend,
        "pose_sigma_m": points.pose_sigma_m,
        "depth_gain": points.depth_gain,
        "depth_gain_sigma": points.depth_gain_sigma,
        "metric_claim": points.metric_claim,
        "statistics": dict(points.statistics),
    }


def _mesh(result: Reconstruction) -> dict[str, Any]:
    mesh = result.mesh
    return {
        "method": mesh.method,
        "resolution_m": mesh.resolution,
        "noise_m": mesh.noise_m,
        "invented_triangles": int(np.count_nonzero(mesh.invented)),
        **quality_dict(mesh.quality),
        "residuals": [{"frame": r.name, "median_abs_m": r.median_abs_m} for r in mesh.residuals],
    }


def quality_dict(quality: MeshQuality) -> dict[str, Any]:
    """The checks of a mesh as JSON-able values."""
    return {k: getattr(quality, k) for k in quality.__dataclass_fields__}


def versions() -> dict[str, str]:
    """Versions of realsim, Python and the packages that decide the result."""
    out = {"realsim": __version__, "python": machine.python_version()}
    for name in _PACKAGES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            continue
    return out
