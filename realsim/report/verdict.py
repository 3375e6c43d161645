"""Can this scene be trusted? A few checks with stated limits; the worst of them is the verdict."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.contact_limits import shares
from realsim.core.meshes import across
from realsim.core.types import Dropped, Reconstruction, ScaleEstimate
from realsim.report.page import Level


@dataclass(frozen=True)
class Check:
    """One question put to the result."""

    name: str
    found: str
    """Measured value with its unit."""
    limits: str
    """The rule in words."""
    level: Level
    reason: str
    """One sentence for the banner if the level is not good."""
    advice: str = ""
    """What to do if the level is not good."""
    shown: str = ""
    """What of the map and the 3D view shows it: `unseen` surface, or the worst of the objects that were `dropped`."""


@dataclass(frozen=True)
class Judgement:
    """The verdict and how it came about."""

    checks: tuple[Check, ...]

    @property
    def failed(self) -> list[Check]:
        """The checks that are not good, the worst first."""
        return [c for level in ("bad", "look") for c in self.checks if c.level == level]

    @property
    def level(self) -> Level:
        """That of the worst check."""
        return self.failed[0].level if self.failed else "good"

    @property
    def headline(self) -> str:
        """What most stands against the scene."""
        return (*self.reasons, "Every check passed: the scene can be used as it is.")[0]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not better, the worst first."""
        return tuple(c.reason for c in self.failed)

    @property
    def next_steps(self) -> tuple[str, ...]:
        """What to do about the reasons, in their order, each once: what another says too and more of is left out."""
        steps = tuple(dict.fromkeys(c.advice for c in self.failed if c.advice))
        return tuple(s for s in steps if not any(other.startswith(f"{s}; ") for other in steps))

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        checks = [{"name": c.name, "found": c.found, "limits": c.limits, "level": c.level} for c in self.checks]
        return {
            "level": self.level,
            "headline": self.headline,
            "reasons": list(self.reasons),
            "next": list(self.next_steps),
            "checks": checks,
        }


def judge(result: Reconstruction) -> Judgement:
    """Run all checks that apply to this result."""
    return Judgement(tuple(c for check in _CHECKS for c in check(result)))


def graded(
    name: str,
    value: float,
    look: float,
    bad: float,
    show: Callable[[float], str],
    *,
    low_is_bad: bool = False,
    advice: str = "",
    shown: str = "",
) -> Check:
    """A check of a number against two limits; what is not finite is bad."""
    sign = -1 if low_is_bad else 1
    level: Level = "good"
    if not math.isfinite(value) or sign * value > sign * bad:
        level = "bad"
    elif sign * value > sign * look:
        level = "look"
    word = "below" if low_is_bad else "above"
    limits = f"check {word} {show(look)}" + (f", reject {word} {show(bad)}" if math.isfinite(bad) else "")
    limit = bad if level == "bad" else look
    where = f"just {word}" if show(value) == show(limit) else word
    reason = f"{name}: {show(value)}, {where} the limit of {show(limit)}."
    return Check(name, show(value), limits, level, reason, advice, shown)


_SCALE = "record more frames with depth between 0.3 and 3 m, or give metric camera poses"
_FLOOR = "record at least 1 m² of level ground around the terrain, from less than 2 m away"
_OVERLAP = "record again more slowly: 15 to 30 cm between views, each sharing half of its picture with the one before"
_COVER = "record again from closer and from both sides until every top and the ground between them has been in view"
_METRES = (
    "measure something of known length in the scene; if it is off, pass --ignore-poses or correct the depth's scale"
)
_ROLES = "name the platforms yourself: --start X Y --goal X Y --overwrite, in metres as on the map from above"
_POSES = "check the camera poses and the unit of the depth (`realsim inspect`), or try --poses estimate"
_FOUND = "check the unit of the depth (`realsim inspect`), or record again from closer and more slowly"
_MESH = "look at the mesh with `realsim view`, or try another --resolution"
_TOUCH = "look at the collision geometry with `realsim view`, or try another --contact"


def percent(value: float) -> str:
    """A share as text."""
    return f"{100 * value:.2g}\u00a0%" if abs(value) < 0.1 else f"{100 * value:.0f}\u00a0%"


def millimetres(value: float) -> str:
    """A length as text."""
    return f"{1000 * value:.1f}\u00a0mm"


def scale_of(result: Reconstruction) -> ScaleEstimate | None:
    """The scale estimate, or None for a scan."""
    return result.aligned.metric.scale if result.aligned.metric is not None else None


def _scale(result: Reconstruction) -> Iterator[Check]:
    estimate = scale_of(result)
    if estimate is None:
        return
    half = (estimate.ci90[1] - estimate.ci90[0]) / 2 / estimate.value
    yield graded("Scale uncertainty (90 % interval, half width)", half, 0.015, 0.03, percent, advice=_SCALE)
    limits: Mapping[str, Any] = result.config.get("scale", {})
    look, bad = float(limits.get("warn_spread", 0.05)), float(limits.get("max_spread", 0.25))
    yield graded("Disagreement of scale between frames", estimate.per_frame_spread, look, bad, percent, advice=_SCALE)


def _metres(result: Reconstruction) -> Iterator[Check]:
    """Poses and depth are two sources of metres; more than such a sensor can be off, one of them is wrong."""
    metric, sigma = result.aligned.metric, getattr(result.source, "sensor_sigma", None)
    if metric is None or not sigma:
        return
    apart = abs(math.log(metric.depth_gain))
    yield graded("Difference of scale between poses and depth", apart, 3 * sigma, 6 * sigma, percent, advice=_METRES)


def _gravity(result: Reconstruction) -> Iterator[Check]:
    gravity = result.aligned.gravity
    yield graded("Tilt uncertainty of the ground", gravity.tilt_sigma_deg, 0.3, 1.0, "{:.2g}°".format, advice=_FLOOR)
    yield graded("Roughness of the ground (RMS)", gravity.inlier_rms_m, 0.020, 0.050, millimetres, advice=_FLOOR)


def _frames(result: Reconstruction) -> Iterator[Check]:
    metric = result.aligned.metric
    if metric is None:
        return
    used, lost = len(metric), sum(d.lost for _, d in _left_out(result))
    share = used / max(used + lost, 1)
    advice = f"{_OVERLAP}; not used: {_some([d.name for _, d in _left_out(result) if d.lost])}"
    yield graded("Frames that fit together", share, 0.8, 0.3, percent, low_is_bad=True, advice=advice)


def _some(names: Sequence[str], shown: int = 4) -> str:
    """The first few names, and how many more there are."""
    rest = len(names) - shown
    return ", ".join(names[:shown]) + (f" and {rest} more" if rest > 0 else "")


def dropped_frames(result: Reconstruction) -> list[tuple[str, str, str]]:
    """(frame, stage, reason) of every frame left out, in order, each once."""
    return [(d.name, stage, d.reason) for stage, d in _left_out(result)]


def _left_out(result: Reconstruction) -> list[tuple[str, Dropped]]:
    """(stage, frame) of every frame left out, in order, each once."""
    parts = [
        ("capture", getattr(result.source, "dropped", ())),
        ("points", result.points.dropped if result.points else ()),
        ("scale", result.aligned.metric.dropped if result.aligned.metric else ()),
    ]
    rows: dict[str, tuple[str, Dropped]] = {}
    for stage, dropped in parts:
        for d in dropped:
            rows.setdefault(d.name, (stage, d))
    return list(rows.values())


def _platforms(result: Reconstruction) -> Iterator[Check]:
    missing = [role for role in ("start", "goal") if result.aligned.platform(role) is None]
    goal = result.aligned.platform("goal")
    if missing == ["start"] and goal is not None and goal.inferred:  # a tread is no place to start
        yield Check(
            "Start and goal platforms", "the way begins on the ground", "check if one is missing", "good", "", ""
        )
        return
    found = f"{len(result.aligned.platforms)} found" + (f", no {' and no '.join(missing)}" if missing else "")
    reason = f"No {' and no '.join(missing)} platform was found: origin and axes rest on assumptions."
    level: Level = "look" if missing else "good"
    yield Check("Start and goal platforms", found, "check if one is missing", level, reason, _ROLES)


def _surface(result: Reconstruction) -> Iterator[Check]:
    mesh = result.mesh
    if mesh.residuals:
        typical = float(np.median([r.median_abs_m for r in mesh.residuals]))
        points = result.points
        estimated = points is not None and points.statistics.get("poses") == "estimated"
        advice = _FOUND if estimated else _POSES
        yield graded("Distance of the depth from the mesh (median)", typical, 0.006, 0.020, millimetres, advice=advice)
    yield from _coverage(result)
    q = mesh.quality
    faults = [
        f"{count} {what}"
        for count, what in (
            (0 if q.manifold else 1, "non-manifold spot or more"),
            (q.self_intersections, "self-intersections"),
            (q.degenerate, "degenerate triangles"),
        )
        if count
    ]
    text = ", ".join(faults) or "none"
    level: Level = "look" if faults else "good"
    yield Check("Faults of the mesh", text, "check if there is one", level, f"The mesh has faults: {text}.", _MESH)


def _coverage(result: Reconstruction) -> Iterator[Check]:
    """What no camera saw weighs by where it is: on the robot's way it decides; elsewhere, and where nobody knows the
    way, it is for a person to judge."""
    found = result.mesh.statistics.get("unseen", {})
    advice = _look_from(result)
    # Share of the upward-facing surface that was invented.
    mesh = result.mesh
    up = np.maximum(across(mesh.vertices, mesh.triangles)[:, 2] / 2, 0)  # areas as seen from above
    share = float(up[mesh.invented].sum() / max(up.sum(), 1e-12))
    if found.get("way_area_m2", 0) > 0:
        on_way = found["way_unseen_m2"] / found["way_area_m2"]
        name = "Ground and tops on the way from start to goal that no camera saw"
        yield graded(name, on_way, 0.15, 0.5, percent, advice=advice, shown="unseen")
        beyond = found["area_m2"] - found["way_area_m2"]
        share = (found["unseen_m2"] - found["way_unseen_m2"]) / beyond if beyond > 0.01 else 0.0
        name = "Ground and tops beside the way that no camera saw"
        yield graded(name, share, 0.5, math.inf, percent, advice=advice, shown="unseen")
    else:
        name = "Ground and tops that no camera saw"
        yield graded(name, share, 0.15, math.inf, percent, advice=advice, shown="unseen")


def _look_from(result: Reconstruction) -> str:
    """From where what is missing would be seen, in words."""
    found = result.mesh.statistics.get("unseen", {})
    if "look_from" not in found or found["share"] < 0.3 or result.aligned.metric is None:
        return _COVER
    x, y = found["look_from"]
    start, goal = result.aligned.platform("start"), result.aligned.platform("goal")
    side = "left" if y > 0 else "right"
    if goal is not None and x > goal.centroid[0] + goal.size[0] / 2:
        where = "from beyond the goal, looking back"
    elif start is not None and goal is not None and x < start.centroid[0] - start.size[0] / 2:
        where = "from behind the start"
    elif goal is not None:
        where = f"along the {side} of the way from start to goal"
    else:
        where = "from elsewhere (x is where the first camera looked)"
    return (
        f"record again {where}, about x {x:.1f}, y {y:.1f} m at eye height: from there {percent(found['share'])} of "
        "what is missing would be in view"
    )


def _contact(result: Reconstruction) -> Iterator[Check]:
    """What a robot would feel against what the cameras saw."""
    for name, share, look, bad in shares(result.scene.contact):
        yield graded(name, share, look, bad, percent, advice=_TOUCH)
    held = result.scene.contact.get("held", 0)
    yield graded("Balls thrown onto it that stay between parts", held, 0, math.inf, "{:d}".format, advice=_TOUCH)


def _physics(result: Reconstruction) -> Iterator[Check]:
    drops = [d for d in result.scene.checks.get("drops", ()) if "error_m" in d]
    if drops:
        worst = max(drops, key=lambda d: abs(d["error_m"]))
        name = "Resting height of dropped objects (worst error)"
        advice = f"{_TOUCH}; the {worst['object']} on {worst['platform']} is the worst"
        yield graded(name, abs(worst["error_m"]), 0.008, 0.03, millimetres, advice=advice, shown="dropped")


def _warnings(result: Reconstruction) -> Iterator[Check]:
    for warning in result.warnings:
        yield Check("Warning", warning, "check if there is one", "look", f"{warning[:1].upper()}{warning[1:]}.")
    if not result.warnings:
        yield Check("Warnings", "none", "check if there is one", "good", "")


_CHECKS = (_scale, _metres, _gravity, _frames, _platforms, _surface, _contact, _physics, _warnings)
