"""Which sets of causes are probable: best-first search by add, drop, swap and widen within Occam's window."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from realsim.gap.selection.figures import EXPANSIONS, OCCAM_WINDOW, PROPOSED
from realsim.gap.selection.fitting import Fit, Fitter, Named
from realsim.gap.selection.proposals import PROPOSALS, Proposal

Tick = Callable[[str, float], None]


@dataclass
class Posterior:
    """Sets of causes with their probabilities, the most probable first."""

    fits: list[Fit]
    """The best fit of each set, whatever its parameters."""
    probabilities: list[float]
    nothing: Fit
    tried: dict[frozenset, Fit] = field(default_factory=dict)
    log: list[str] = field(default_factory=list)


def log_odds(fitter: Fitter, fit: Fit) -> float:
    """Log prior odds of a set against no cause: one is expected, at any of the places of any effect alike."""
    slots = {(c.effect, c.place) for c in fitter.screen.candidates}
    return -len(fit.causes) * float(np.log(len(slots)))


def select(
    fitter: Fitter, rough: Fitter, most: int, known: Sequence[Fit] = (), tick: Tick = lambda what, share: None
) -> Posterior:
    """Best-first: the best set that was not expanded yet is, as long as it lies in Occam's window."""
    nothing = fitter.fit(())
    assert nothing is not None
    seen: dict[frozenset, Fit] = {nothing.key: nothing}
    for fit in known[:PROPOSED]:  # of an earlier linearisation
        if (again := fitter.fit(fit.causes)) is not None:
            seen[again.key] = again
    expanded: set[frozenset] = set()
    log: list[str] = []

    price = float(np.log(len({(c.effect, c.place) for c in fitter.screen.candidates})))

    def worth(fit: Fit) -> float:
        return fit.evidence + log_odds(fitter, fit)

    for k in range(EXPANSIONS):
        best = max(map(worth, seen.values()))
        waiting = [f for f in seen.values() if f.key not in expanded and worth(f) > best - OCCAM_WINDOW
                   and not any(g.named < f.named and worth(g) >= worth(f) for g in seen.values())]  # fmt: skip
        if not waiting:
            break
        here = max(waiting, key=worth)
        expanded.add(here.key)
        tick("selection", k / EXPANSIONS)
        log.append(f"expand {worth(here):.1f} {said(here)}")
        proposals = [p for propose in PROPOSALS for p in propose(fitter, here)]
        proposals = [p for p in proposals if len(p.causes) <= most and not _known(p, seen) and not _twice(p)]
        for proposal in shortlist(rough, proposals, price):
            target = max(map(worth, seen.values())) - OCCAM_WINDOW + len(proposal.causes) * price
            found = fitter.fit(proposal.causes, proposal.starts, target)
            if found is None:
                continue
            if found.key not in seen or found.evidence > seen[found.key].evidence:
                seen[found.key] = found
            log.append(f"  {proposal.by} {proposal.foretold:.1f} -> {worth(found):.1f} {said(found)}")
    return posterior(fitter, list(seen.values()), nothing, seen, log)


def shortlist(rough: Fitter, proposals: list[Proposal], price: float) -> list[Proposal]:
    """The proposals that do best on a few runs, with the values found there: the others are not fitted further."""
    done: dict[frozenset, tuple[float, Proposal]] = {}
    for proposal in proposals:
        best = max((worth for worth, _ in done.values()), default=-np.inf)
        fit = rough.fit(proposal.causes, proposal.starts, best - OCCAM_WINDOW + len(proposal.causes) * price, rounds=2)
        if fit is not None:
            worth = fit.evidence - len(fit.causes) * price
            if worth > done.get(fit.key, (-np.inf,))[0]:
                done[fit.key] = worth, replace(proposal, causes=fit.causes, starts=())
    return [p for _, p in sorted(done.values(), key=lambda item: -item[0])[:PROPOSED]]


def posterior(fitter: Fitter, fits: list[Fit], nothing: Fit, seen: dict, log: list[str]) -> Posterior:
    """Probabilities over sets; fits of one set with other parameters count together."""
    worth = np.array([f.evidence + log_odds(fitter, f) for f in fits])
    weight = np.exp(worth - worth.max())
    weight /= weight.sum()
    total: dict[Named, float] = {}
    best: dict[Named, int] = {}
    for i, fit in enumerate(fits):
        total[fit.named] = total.get(fit.named, 0.0) + float(weight[i])
        if fit.named not in best or worth[i] > worth[best[fit.named]]:
            best[fit.named] = i
    order = sorted(total, key=lambda n: -total[n])
    return Posterior([fits[best[n]] for n in order], [total[n] for n in order], nothing, seen, log)


def said(fit: Fit) -> str:
    return (
        "; ".join(
            f"{c.candidate.effect}@{','.join(c.candidate.place)} "
            + " ".join(f"{n}={v:.4g}" for n, v in c.named.items())
            for c in fit.causes
        )
        or "nothing"
    )


def _known(proposal: Proposal, seen: dict) -> bool:
    return frozenset(c.candidate.key for c in proposal.causes) in seen


def _twice(proposal: Proposal) -> bool:
    slots = [(c.candidate.effect, p) for c in proposal.causes for p in c.candidate.places]
    return len(set(slots)) < len(slots)
