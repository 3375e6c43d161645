"""What simpler rules would have said, so that the diagnosis can be held against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from realsim.gap.answer.heldout import errors, mean_square
from realsim.gap.causes.fit import Fit
from realsim.gap.causes.leftover import nuisance_settings
from realsim.gap.causes.linear import posterior
from realsim.gap.causes.screen import Screen
from realsim.gap.causes.select import Selection
from realsim.gap.compare import Comparison
from realsim.gap.effects import EFFECTS
from realsim.gap.simulation.simulate import Setting, lookup
from realsim.types import F64


def first_choices(screen: Screen, selection: Selection) -> dict[str, dict[str, Any]]:
    """Rule -> the cause that it names first: {effect, joints or bodies}.

    - largest single-effect fit: whichever effect, refitted alone, removes most; no small deviations, no unseen runs.
    - signature alone: the effect whose footprint has the largest correlation with the error.
    - fit everything and rank: ridge over all effects at once, the one that carries most of the fit.
    """
    found = {}
    single = [t for t in selection.trials if t.stage == 0 and t.gain is not None]
    if single:
        best = max(single, key=lambda t: t.gain or 0.0)
        found["largest single-effect fit"] = _named(best.effect, best.place)
    effects = [i for i, a in enumerate(screen.atoms) if a.effect in EFFECTS]
    if not effects:  # none of those asked for can act on this robot
        return found
    A, b, c = _plain(screen, selection.nominal)
    size = np.sqrt(np.maximum(np.diag(A), 1e-30))
    alike = np.abs(b) / (size * np.sqrt(max(c, 1e-30)))
    found["signature alone"] = _atom(screen, max(effects, key=lambda i: float(alike[i])))
    x, _ = posterior(A, b, _wide(screen))
    found["fit everything and rank"] = _atom(screen, max(effects, key=lambda i: float(abs(x[i]) * size[i])))
    return found


def rival_settings(screen: Screen, comparison: Comparison, selection: Selection) -> dict[str, Sequence[Setting]]:
    """Settings of the rivals that the shrinkage is printed beside: the best wrong effect, all effects at once."""
    rivals: dict[str, Sequence[Setting]] = {}
    mine = {c.candidate.effect for c in selection.fit.causes}
    same = {c.candidate.effect for f in selection.equivalent for c in f.causes}
    others = [t for t in selection.trials if t.gain is not None and t.stage == 0 and t.effect not in mine | same]
    if others:
        best = max(others, key=lambda t: t.gain or 0.0)
        tried = next(c for c in screen.candidates if c.effect == best.effect and c.place == best.place)
        rivals[f"best wrong effect ({best.effect})"] = tried.settings(best.values)
    rivals["all effects at once"] = _everything(screen, comparison, selection.nominal)
    return rivals


def _everything(screen: Screen, comparison: Comparison, nominal: Fit) -> list[Setting]:
    """Ridge over all effects, as far along its way as the simulator still gains on the fitted runs.

    Laws that need joints or a time step of their own stay out: at every joint at once they cost more than all else.
    """
    wide = replace(nominal, prior=_wide(screen))
    best: tuple[float, list[Setting]] = (np.inf, [])
    for scale in (1.0, 0.5, 0.25):
        settings = [s for s in nuisance_settings(screen, wide, scale) if s[0] in EFFECTS and not EFFECTS[s[0]].stiff]
        left = errors(screen.simulator, comparison, settings, screen.runs)
        if left is not None and (error := mean_square(comparison, left, screen.runs)) < best[0]:
            best = (error, settings)
    return best[1]


def _wide(screen: Screen) -> F64:
    return np.array([max(a.parameter.nuisance, abs(a.parameter.step)) for a in screen.atoms])


def _plain(screen: Screen, nominal: Fit) -> tuple[F64, F64, float]:
    """Normal equations of the nominal error, all fitted runs together."""
    e = nominal.evidence
    return np.sum(e.A, axis=0), np.sum(e.b, axis=0), float(sum(e.c))


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
