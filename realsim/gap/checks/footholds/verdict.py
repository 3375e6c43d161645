"""One verdict for a scene: what its scan says of itself, and what a robot's log on it says."""

from dataclasses import dataclass, field
from math import degrees
from pathlib import Path
from typing import Any

from realsim.core.errors import RealsimError
from realsim.core.files import read_json
from realsim.core.statistics import Interval
from realsim.gap.checks.camera.calibrate import CameraFound
from realsim.gap.checks.footholds.footholds import Foothold, FootholdMap
from realsim.report.page import Level

MANY = 0.25
"""Share of footholds that differ, or of contacts beside all tops, from which a scene is no longer the one on which the
robot walked. Set by hand."""
WORST: tuple[Level, ...] = ("bad", "look", "good")


@dataclass(frozen=True)
class SceneVerdict:
    """Whether the scene can be trained on, in the words of all of realsim's verdicts."""

    level: Level
    headline: str
    reasons: tuple[str, ...]
    next: tuple[str, ...]
    scan: dict[str, Any] | None = field(default=None, repr=False)
    """The verdict of the reconstruction, where its report lies beside the scene."""

    def as_dict(self) -> dict[str, Any]:
        return {"level": self.level, "headline": self.headline, "reasons": list(self.reasons), "next": list(self.next)}


def judge(found: FootholdMap, scene: Path, camera: CameraFound | None = None) -> SceneVerdict:
    """The verdict of scan, feet and camera together: the worst of them."""
    scan = scan_verdict(scene)
    reasons, steps = [], []
    level: Level = "good"
    share = len(found.changed) / max(len(found.footholds), 1)
    beside = found.lost / max(found.contacts, 1)
    if found.changed:
        level = "bad" if share > MANY else "look"
        reasons += [sentence(hold) for hold in found.changed]
        steps.append("train on the corrected scene.xml of this output, or scan the terrain again")
    if beside > MANY:
        level = "bad"
        reasons.append(f"{found.lost} of {found.contacts} contacts lie where the scene has no top")
        steps.append("check that base_pos is in the scene's frame, and that the scene covers where the robot walked")
    if camera is not None and camera.named:
        level = min(level, "look", key=WORST.index)
        reasons += camera.sentences()
        steps.append("give the simulated camera this delay, mount and noise, or mend the robot's")
    if scan is not None and scan["level"] != "good":
        level = min(level, scan["level"], key=WORST.index)
        reasons += [f"the scan: {reason}" for reason in scan.get("reasons", [])]
        steps += list(scan.get("next", []))
    count = len(found.footholds)
    if found.changed:
        head = f"{len(found.changed)} of {count} footholds differ from the scan."
    elif level == "good":
        head = f"the robot stood on {count} footholds as they were scanned."
    elif camera is not None and camera.named:
        head = f"{count} footholds are as scanned, but the camera is not as in the model."
    else:
        head = f"{count} footholds are as scanned, but there is more to say."
    return SceneVerdict(level, head, tuple(reasons), tuple(dict.fromkeys(steps)), scan)


def scan_verdict(scene: Path) -> dict[str, Any] | None:
    """The reconstruction's verdict on the scene, from report.json beside it; None where there is none."""
    file = (scene if scene.is_dir() else scene.parent) / "report.json"
    if not file.is_file():
        return None
    try:
        found = read_json(file)
    except RealsimError:
        return None
    verdict = found.get("verdict") if isinstance(found, dict) else None
    known = isinstance(verdict, dict) and verdict.get("level") in WORST
    return verdict if known else None


def sentence(hold: Foothold) -> str:
    """A foothold's changes as a sentence."""
    q = hold.quantities
    parts = []
    for kind in hold.changes:
        if kind == "height":
            parts.append(f"{'higher' if q['height'].value > 0 else 'lower'} by {_size(q['height'])} mm")
        elif kind == "tilt":
            parts += [f"tilted by {q[f'tilt_{axis}'].text('.1f', degrees(1))}° about {axis}" for axis in "xy"]
        elif kind == "give":
            parts.append(f"softer: it gives way by {_size(q['give'])} mm under the robot's weight")
        elif kind == "slip":
            at = f", friction {q['friction'].text('.2f')}" if "friction" in q else ""
            parts.append(f"slippery: feet slide {_size(q['slip'])} mm a contact{at}")
        elif kind == "wobble":
            parts.append(f"wobbling: feet sway {_size(q['wobble'])} mm when it is loaded 2 cm off its middle")
    return f"{hold.name} is {', and '.join(parts)} ({hold.touches} contacts in {hold.runs} runs)"


def _size(q: Interval) -> str:
    """A length without its sign in mm, with its interval."""
    return (q if q.value > 0 else Interval(-q.value, -q.high, -q.low)).text(".0f", 1e3)
