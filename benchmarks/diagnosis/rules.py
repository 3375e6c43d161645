"""What simpler rules would have named first, so that the diagnosis can be held against them."""

from __future__ import annotations

from typing import Any

import numpy as np

from realsim.gap.effects import EFFECTS
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.select import Selection
from realsim.gap.inference.likelihood.linear import posterior
from realsim.gap.inference.likelihood.screen import Screen


def first_choices(screen: Screen, selection: Selection) -> dict[str, Any]:
    """`baselines`: rule -> the cause that it names first, {effect, joints or bodies}. For `diagnose(look=...)`.

    - largest single-effect fit: whichever effect, refitted alone, removes most; no small deviations, no unseen runs.
    - signature alone: the effect whose footprint has the largest correlation with the error.
    - fit everything and rank: ridge over all effects at once, the one that carries most of the fit.
    """
    found: dict[str, dict[str, Any]] = {}
    single = [t for t in selection.trials if t.stage == 0 and t.gain is not None]
    if single:
        best = max(single, key=lambda t: t.gain or 0.0)
        found["largest single-effect fit"] = _named(best.candidate.effect, best.candidate.place)
    effects = [i for i, a in enumerate(screen.atoms) if a.effect in EFFECTS]
    if not effects:  # none of those asked for can act on this robot
        return {"baselines": found}
    e = selection.nominal.evidence
    A, b, c = np.sum(e.A, axis=0), np.sum(e.b, axis=0), float(sum(e.c))
    size = np.sqrt(np.maximum(np.diag(A), 1e-30))
    alike = np.abs(b) / (size * np.sqrt(max(c, 1e-30)))
    found["signature alone"] = _atom(screen, max(effects, key=lambda i: float(alike[i])))
    wide = np.array([max(a.parameter.nuisance, abs(a.parameter.step)) for a in screen.atoms])
    x, _ = posterior(A, b, wide)
    found["fit everything and rank"] = _atom(screen, max(effects, key=lambda i: float(abs(x[i]) * size[i])))
    return {"baselines": found}


def _atom(screen: Screen, i: int) -> dict[str, Any]:
    return _named(screen.atoms[i].effect, screen.atoms[i].place)


def _named(effect: str, place: tuple[str, ...]) -> dict[str, Any]:
    scope = lookup(effect).scope
    found: dict[str, Any] = {"effect": effect}
    if scope == "joint":
        found["joints"] = list(place)
    elif scope in ("body", "terrain"):
        found["bodies"] = list(place)
    return found
