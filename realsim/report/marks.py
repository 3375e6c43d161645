"""Places that decide a verdict, as the map and the 3D view mark them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.meshes import merged
from realsim.core.types import F64, Reconstruction, platform_names
from realsim.report.solids import rod
from realsim.report.verdict import Judgement
from realsim.report.viewer3d import Layer

INK = (214, 40, 40)
HEIGHT = 0.4
"""Metres of the post at a place; a line would be one pixel thin."""
RADIUS = 0.012


@dataclass(frozen=True)
class Mark:
    """A place, simulation frame."""

    at: F64
    """(3,) metres."""
    text: str


def marks_of(result: Reconstruction, judgement: Judgement) -> list[Mark]:
    """Where objects fell through, the worst of those that were dropped, and where to stand to see what is missing."""
    shown = {c.shown for c in judgement.failed}
    marks = leaks_of(result.scene.contact)
    drops = [d for d in result.scene.checks.get("drops", ()) if "error_m" in d]
    if "dropped" in shown and drops:
        worst = max(drops, key=lambda d: abs(d["error_m"]))
        name = str(worst["platform"])
        known = dict(zip(platform_names(result.aligned.platforms), result.aligned.platforms, strict=True))
        marks.append(Mark(known[name].centroid, f"{worst['object']}: {1000 * worst['error_m']:+.0f} mm"))
    place = result.mesh.statistics.get("unseen", {}).get("look_from")
    if "unseen" in shown and place is not None:
        marks.append(Mark(np.array([*place, result.aligned.ground_z]), "look from here"))
    return marks


def leaks_of(contact: Mapping[str, Any]) -> list[Mark]:
    """Where balls fell into what should be solid."""
    return [Mark(np.asarray(at, float), "fell through") for at in contact.get("leak_places", ())]


def marks_layer(marks: Sequence[Mark]) -> list[Layer]:
    """A post at each place; no layer without any."""
    if not marks:
        return []
    posts = [rod(m.at, m.at + np.array([0, 0, HEIGHT]), RADIUS) for m in marks]
    return [Layer("what decides", *merged(posts), INK)]
