"""Fit causes with the full nonlinear simulation; the small deviations are marginalised on the way."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fitted import Cause as Cause
from realsim.gap.inference.causes.fitted import Fit as Fit
from realsim.gap.inference.causes.fitted import at, deviations, form, is_gap, leftover, parameters_of, spread, values_of
from realsim.gap.inference.causes.gauss_newton import Few, GaussNewton, Rough, clip, widest
from realsim.gap.inference.evidence.onsets import find_onsets
from realsim.gap.inference.likelihood.linear import bounded


class Fitter(GaussNewton):
    """What the selection asks of a fit: causes at their best values, measured on all runs of a screen."""

    def prepared(self, fit: Fit, further: bool = False) -> Fit:
        """The set under weights that follow from what it leaves, with slopes about its causes; those of candidates,
        too, if a `further` cause is looked for.

        The discrepancy between robot and model is estimated with each set. Else a large gap would be fitted by absurd
        values of many nuisance parameters, since sensors are so precise that their prior does not count.
        """
        screen, simulator, settings = self.screen, self.screen.simulator, fit.settings()
        here = self.under(about=fit.about)
        if fit.causes and not self.conditions.onsets:  # a lasting cause drowns a push until it is known
            here = here.under(onsets=find_onsets(screen.comparison, simulator.simulate(settings), screen.runs))
        fit = here.reweighted(fit)
        # Beside no gap, no further cause is looked for among many deviations, and the slopes that are there will do.
        if fit.causes and (further or not screen.crowded or is_gap(leftover(screen, fit))):
            if not any(lookup(c.candidate.effect).law.stiff for c in fit.causes):  # each slope at many times the steps
                screen.relinearise(settings, fit.conditions, further)
            here = here.under_those_of(fit)
            fit = here.reweighted(here.with_likelier_solver(here.remeasure(fit)))
        if not (simulator.context.touches or is_gap(leftover(screen, fit))):
            return fit
        return here.under_those_of(fit).with_deviations(fit)

    def nominal(self) -> Fit:
        """No cause at all."""
        return self.measured(())

    def with_likelier_solver(self, fit: Fit) -> Fit:
        """With the solver's other friction cone and the like, each where it explains most of the gap by itself.

        What is one or the other is tried, not sloped: beside slipping feet its slope says little of it, and lower
        friction imitates it. Beside causes the gap is theirs, and what stays of it may be the solver's.
        """
        about = self.conditions.about
        for i in [i for i, atom in enumerate(self.screen.atoms) if atom.parameter.whole]:
            other, cost = np.where(np.arange(len(about)) == i, 1.0 - about, about), self._cost(fit)
            moved = self.under(about=other).looked_at(fit, fit.causes)
            most = cost - 2 * figures.NEAR if fit.causes else figures.SWITCHED * cost
            if moved is not None and self._cost(moved) < most:
                fit, about = moved, other
        return fit

    def with_deviations(self, fit: Fit) -> Fit:
        """With everyday deviations simulated where that leaves no gap, and else with linear ones: beside a large gap,
        many of them would be bent to imitate a cause, and hide it from its own rivals. The solver's ways stay."""
        ways = {atom.effect for atom in self.screen.atoms if atom.parameter.whole}
        for _ in range(2):
            fit = self.under_those_of(fit).reweighted(self.under_those_of(fit).beside_own(fit))
            if not is_gap(leftover(self.screen, fit)):
                return fit
        about = np.where([atom.effect in ways for atom in self.screen.atoms], fit.about, 0.0)
        plain = self.under_those_of(fit.under(about=about))
        return plain.reweighted(plain.looked_at(fit, fit.causes) or fit)

    def beside_own(self, fit: Fit) -> Fit:
        """The same causes beside the everyday deviations that are most probable beside them, by simulation: slopes lead
        there in a few steps, each halved where the simulation itself does not come nearer; none is tried that slopes
        themselves give too little for, but where feet slip and land, of which they tell little."""
        touches = self.screen.simulator.context.touches
        whole = [atom.parameter.whole for atom in self.screen.atoms]
        nearer: Fit | None = fit
        while nearer is not None:
            fit, nearer = nearer, None
            x = self.screen.possible(fit.evidence.centre + deviations(self.screen, fit))
            least = self._cost(fit) - 2 * figures.CLEARLY
            for share in figures.PARTS if touches or self._cost(fit, x - fit.about) < least else ():
                about = np.where(whole, fit.about, fit.about + share * (x - fit.about))
                moved = self.under(about=about).looked_at(fit, fit.causes)
                if moved is not None and self._cost(moved) < least:
                    nearer = moved
                    break
        return fit

    def beside_those(self, other: Fit, fit: Fit) -> Fit | None:
        """The causes of a fit beside deviations that are searched for from those of another one."""
        there = self.under(about=other.about).looked_at(fit, fit.causes)
        return self.beside_own(there) if there is not None else None

    def settled(self, fit: Fit) -> Fit:
        """The set beside its own everyday deviations. Where feet slip and land, its last cause is moved to where the
        simulation agrees best: slopes are those of a moment there, and what lies a good step off is looked at."""
        if not (fit.causes and self.screen.simulator.context.touches):
            return self.beside_own(fit)
        for size in figures.SLIDES:
            fit = self.beside_own(self._slid(fit, size))
        again = self.under(about=fit.about).fit(fit.causes, iterations=3, few=self.rough(fit))
        return again if again is not None and again.misfit < fit.misfit else fit

    def _slid(self, fit: Fit, size: float) -> Fit:
        """With the strength of the last cause changed by this share, and the times of one that passes by so many
        seconds, as long as that gains."""
        parameters = fit.causes[-1].candidate.parameters
        times = set(lookup(fit.causes[-1].candidate.effect).law.passing)
        strong = [p.name for p in parameters if p.strength and p.name not in times]
        groups = [*([p.name] for p in parameters if p.name in times), strong]
        (*others, last), few, beside = fit.causes, self.rough(fit), self.under(about=fit.about)

        def measured(cause: Cause) -> tuple[float, Cause]:
            misfit = beside.misfit((*others, cause), few)
            return np.inf if misfit is None else misfit, cause

        def moved(here: Cause, move: tuple[Sequence[str], float]) -> tuple[float, Cause]:
            names, by = move
            there = [v + by * (1.0 if n in times else v) * (n in names) for n, v in here.named.items()]
            return measured(replace(here, values=tuple(clip(np.array(there), parameters).tolist())))

        best, nearer = measured(last), True
        while nearer:
            looks = self.each(partial(moved, best[1]), [(names, by) for names in groups for by in (size, -size)])
            best, before = min(best, *looks, key=lambda look: look[0]), best
            nearer = best[0] < before[0]
        there = fit if best[1] is last else beside.looked_at(fit, (*others, best[1]))
        return there if there is not None and there.misfit < fit.misfit else fit

    def _cost(self, fit: Fit, x: F64 | float = 0.0) -> float:
        """Weighted squared residual of the simulation itself; with small deviations (p,) added by their slopes."""
        rests = (self.screen.residual(k, y, x) for k, y in enumerate(fit.predictions))
        weights = (self.conditions.weights.of[run] for run in self.screen.runs)
        return float(sum(np.nansum(w * r**2) for w, r in zip(weights, rests, strict=True)))

    def reweighted(self, fit: Fit) -> Fit:
        """Weigh errors against what this fit leaves, and measure it anew."""
        comparison, screen = self.screen.comparison, self.screen
        weights = comparison.tempered(screen.runs, fit.predictions, screen.nominal, form(fit))
        return self.under(weights=weights).remeasure(fit)

    def remeasure(self, fit: Fit) -> Fit:
        """The same fit beside its own nuisances, under these weights."""
        return replace(self.under(about=fit.about).measured(fit.causes), covariance=fit.covariance)

    def looked_at(self, fit: Fit, causes: Sequence[Cause]) -> Fit | None:
        """These causes at their very values, without a search, under the fit's weights; None if the robot falls."""
        try:
            return replace(self.measured(tuple(causes)), covariance=fit.covariance)
        except GapError:
            return None

    def fit(
        self,
        causes: Sequence[Cause],
        starts: Sequence[Sequence[float]] = (),
        iterations: int = 6,
        few: Few = None,
        target: float = np.inf,
    ) -> Fit | None:
        """The best values near the causes' own and the further `starts` (all values in a row); None if none runs.

        A rough fit looks at a `few` while it searches, and is measured on all runs; it is broken off once it would not
        come down to the misfit `target` (of what it looks at) at its present pace.
        """
        begun = self._best_start(causes, [list(values_of(causes)), *starts], few)
        if begun is None:
            return None
        here, _, slopes = self._descend(begun, few, iterations, target)
        try:
            return self.measured(here, True, slopes, few)
        except GapError:  # on a run that a rough fit did not look at
            return None

    def without_each(self, fit: Fit) -> Iterator[tuple[F64, tuple[Cause, ...]]]:
        """((p,) nuisances, causes) fitted to all runs but one, each in turn: one Gauss-Newton step from the values that
        suit all runs leads to those that suit the others."""
        z, parameters, p = values_of(fit.causes), parameters_of(fit.causes), len(fit.prior)
        normal, prior, most = fit.evidence, fit.prior, figures.REASONABLE * fit.prior
        beside = self.under(about=fit.about)
        if slopes := beside.slopes(fit.causes, fit.predictions):
            normal = beside.normal(fit.causes, fit.predictions, slopes)
            prior = np.append(prior, [4 * abs(p.step) for p in parameters])
            most = np.append(most, widest(z, parameters))
        for k in range(len(normal.A)):
            others = normal.without(k)
            x, _ = bounded(np.sum(others.A, axis=0), np.sum(others.b, axis=0), prior, most)
            yield x[:p], at(fit.causes, clip(z + (x[p:] if slopes else 0.0), parameters))

    def of_run(self, fit: Fit, causes: Sequence[Cause], k: int) -> F64:
        """(T, C) prediction of screened run k with these values; the fit's own where that fails."""
        moved = self.under(about=fit.about).predict(causes, Rough((k,))) if causes else None
        return moved[0] if moved else fit.predictions[k]

    def left_out(self, fit: Fit) -> F64:
        """(runs,) half the weighted squares of each run, with values and deviations fitted to all the other runs."""
        found, given = [], replace(self.conditions, about=fit.about)
        for k, (x, causes) in enumerate(self.without_each(fit)):
            here = self.screen.evidence([self.of_run(fit, causes, k)], given, (k,))
            here = here.moved(np.full(len(x), fit.evidence.centre) - here.centre)
            found.append(0.5 * float(here.c[0] - 2 * here.b[0] @ x + x @ here.A[0] @ x))
        return np.array(found)

    def spread(self, fit: Fit) -> Fit:
        """The same fit with its covariance from slopes taken at its very values."""
        return self.under(about=fit.about).measured(fit.causes, True) if fit.causes else fit

    def measured(
        self,
        causes: Sequence[Cause],
        spread_too: bool = False,
        slopes: list[F64] | None = None,
        few: Few = None,
    ) -> Fit:
        """The fit with its evidence, and its covariance if requested, from `slopes` (of the runs looked at)."""
        prior, given = self.prior_beside(causes), self.beside(causes)
        predicted = self.predict(causes)
        if predicted is None:
            raise GapError("the simulator fails with the values found", hint="look at the units of the log")
        evidence = self.screen.evidence(predicted, given)
        misfit, scale = self.screen.misfit(evidence, prior)
        prior = scale * prior
        z, parameters = values_of(causes), parameters_of(causes)
        covariance = np.zeros((len(z), len(z)))
        if spread_too and parameters:
            if slopes is None:
                slopes, few = self.slopes(causes, predicted), None
            if slopes is not None:
                seen = predicted if few is None else [predicted[k] for k in few.runs]
                covariance = spread(*self.local(prior, self.normal(causes, seen, slopes, few)), parameters)
        return Fit(tuple(causes), misfit, covariance, tuple(predicted), given, evidence, prior, scale)
