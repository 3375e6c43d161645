"""The output of `realsim inspect`."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np

from realsim.capture.finishing import Finished
from realsim.capture.layout import Recognition
from realsim.capture.selection import NOT_NEEDED
from realsim.core.geometry import angle_deg
from realsim.core.types import F64, Dropped, Scan


@dataclass(frozen=True, repr=False)
class Inspection:
    """The recognised layout and its evidence, assumptions, figures, and problems."""

    source: str
    layout: str
    evidence: tuple[str, ...]
    """Evidence for the layout."""
    frames: Mapping[str, Any]
    """used, dropped {name: reason}, resolution of depth and colour, intrinsics."""
    depth: Mapping[str, Any]
    """coverage (mean share of pixels with depth in range), the least covered frame, median and 2nd and 98th percentile
    in metres (median over the frames)."""
    poses: Mapping[str, Any]
    """given, path length, baseline and turn between neighbours (median and largest), share of compared pixels where
    depth agrees with the poses, worst deviation from SO(3)."""
    assumptions: tuple[str, ...]
    wrong: tuple[str, ...]
    """Everything that a person should look at."""

    def as_dict(self) -> dict[str, Any]:
        """The same as plain, JSON-able values."""
        return asdict(self)

    def __repr__(self) -> str:
        wrong = f"{len(self.wrong)} to look at" if self.wrong else "no problems found"
        return f"Inspection({self.source!r}, layout {self.layout}, {wrong})"

    def _repr_html_(self) -> str:
        return f"<pre>{escape(self.render())}</pre>"

    def render(self) -> str:
        """The same for a person, a few lines a subject."""
        blocks = [
            ("capture", [self.source, f"layout {self.layout}, recognised by {', '.join(self.evidence)}"]),
            ("frames", _lines(self.frames)),
            ("depth", _lines(self.depth)),
            ("poses", _lines(self.poses)),
            ("assumed", list(self.assumptions)),
            ("look at", list(self.wrong) or ["no problems found"]),
        ]
        text = []
        for title, lines in blocks:
            text += [f"{title if i == 0 else '':9}{line}" for i, line in enumerate(lines)]
        return "\n".join(text) + "\n"


def inspect_frames(finished: Finished, recognition: Recognition) -> Inspection:
    """The inspection of a capture of frames."""
    capture, looks = finished.capture, finished.looks
    cameras = {(f.intrinsics, f.color_intrinsics) for f in capture.frames}
    camera = capture.frames[0].intrinsics
    color_size = looks[0].sizes[1]
    frames = {
        "seen": finished.seen,
        "used": len(capture),
        "dropped": {d.name: d.reason for d in capture.dropped},
        "depth_size": f"{camera.width}x{camera.height}",
        "color_size": None if color_size is None else f"{color_size[0]}x{color_size[1]}",
        "intrinsics": {k: round(getattr(camera, k), 3) for k in ("fx", "fy", "cx", "cy")},
        "cameras": len(cameras),
    }
    widths = [look.edge_px for look in looks if look.edge_px is not None]
    if widths:
        frames["edges_px"] = _spread(widths, 1)
    shares = np.array([look.valid_share for look in looks])
    coverage = round(float(shares.mean()), 3)
    depth = {
        "coverage": coverage,
        "least_coverage": {looks[int(shares.argmin())].name: round(float(shares.min()), 3)},
        "median_m": round(float(np.median([look.median_depth for look in looks])), 3),
        "range_m": {
            "p2": round(float(np.median([look.depth_range[0] for look in looks])), 3),
            "p98": round(float(np.median([look.depth_range[1] for look in looks])), 3),
        },
    }
    wrong = [*capture.warnings, *_losses(capture.dropped)]
    if coverage < 0.3:
        wrong.append(f"only {coverage:.0%} of the pixels have depth in range")
    return Inspection(
        str(capture.source),
        capture.layout,
        recognition.evidence,
        frames,
        depth,
        _pose_figures(finished),
        capture.assumptions,
        tuple(wrong),
    )


def inspect_scan(scan: Scan, recognition: Recognition) -> Inspection:
    """The inspection of a finished surface."""
    extent = np.ptp(scan.points, axis=0)
    figures = {
        "points": len(scan.points),
        "triangles": None if scan.triangles is None else len(scan.triangles),
        "extent_m": [round(float(v), 3) for v in extent],
    }
    return Inspection(
        str(scan.source), scan.layout, recognition.evidence, figures, {}, {}, scan.assumptions, scan.warnings
    )


def _pose_figures(finished: Finished) -> dict[str, Any]:
    frames = finished.capture.frames
    if not finished.capture.has_poses:
        return {"given": False}
    T = np.array([f.T_world_camera for f in frames])
    steps = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    turns = [angle_deg(a[:3, :3].T @ b[:3, :3]) for a, b in pairwise(T)]
    figures: dict[str, Any] = {"given": True, "metric": finished.capture.poses_metric}
    if len(steps):
        figures |= {
            "path_m": round(float(steps.sum()), 3),
            "neighbour_baseline_m": _spread(steps, 4),
            "neighbour_turn_deg": _spread(turns, 2),
        }
    if finished.agreement is not None:
        figures["depth_agrees"] = round(finished.agreement.as_read, 3)
    return figures | {
        "worst_off_so3": float(f"{finished.poses.worst_deviation:.1e}"),
        "mended": finished.poses.mended,
    }


def _spread(values: Sequence[float] | F64, digits: int) -> dict[str, float]:
    return {"median": round(float(np.median(values)), digits), "largest": round(float(np.max(values)), digits)}


def _losses(dropped: Sequence[Dropped]) -> list[str]:
    """One line a reason why frames are lost; frames that are good but not picked are no loss."""
    names: dict[str, list[str]] = {}
    for d in dropped:
        if not d.reason.startswith(NOT_NEEDED):
            names.setdefault(d.reason, []).append(d.name)
    return [f"{who[0] if len(who) == 1 else f'{len(who)} frames'}: {reason}" for reason, who in names.items()]


def _lines(figures: Mapping[str, Any]) -> list[str]:
    lines = []
    for key, value in figures.items():
        if key == "dropped":
            shown = [f"{name}: {reason}" for name, reason in list(value.items())[:8]]
            more = [f"and {len(value) - 8} more"] if len(value) > 8 else []
            lines += [f"{key} {len(value)}", *(f"  {line}" for line in shown + more)]
        elif isinstance(value, Mapping):
            lines.append(f"{key} " + "  ".join(f"{k} {v}" for k, v in value.items()))
        else:
            lines.append(f"{key} {'none' if value is None else value}")
    return lines
