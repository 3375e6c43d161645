"""Fit causes with the full nonlinear simulation; the small deviations are marginalised on the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from realsim.errors import GapError
from realsim.gap.causes.figures import LIKELIER, POLISH, SETTLED, SWITCHED
from realsim.gap.causes.fitted import Cause as Cause
from realsim.gap.causes.fitted import Fit as Fit
from realsim.gap.causes.fitted import causes_of, form, spread
from realsim.gap.causes.gauss_newton import FULL, Fidelity, GaussNewton, widest
from realsim.gap.causes.leftover import deviations, reasonable
from realsim.gap.causes.linear import posterior
from realsim.gap.effects.base import Parameter
from realsim.gap.simulation.nuisances import LIKE_A_CAUSE, NUISANCES
from realsim.types import F64


class Fitter(GaussNewton):
    """What the selection asks of a fit: causes at their best values, measured on all runs of a screen."""

    slight = False
    """Whether small deviations alone could explain the gap."""

    def nominal(self) -> Fit:
        """No cause at all."""
        return self._measure((), None)

    def with_likelier_solver(self, fit: Fit) -> Fit:
        """With the solver's other friction cone and the like, each where it explains most of the gap by itself.

        What is one or the other is tried, not sloped: beside slipping feet its slope says little of it, and lower
        friction imitates it. Beside causes the gap is theirs, and what stays of it may be the solver's.
        """
        for i, atom in enumerate(self.screen.atoms):
            if not (atom.parameter.whole and fit.prior[i] > 0):
                continue
            old = self.about
            cost, share = self._cost(fit), 1.0 if fit.causes else SWITCHED
            least = LIKELIER if fit.causes else 0.0
            self.about = old.copy()
            self.about[i] = sum(atom.parameter.bounds) - old[i]
            moved = self._or_none(fit)
            if moved is not None and fit.misfit - moved.misfit > least and self._cost(moved) < share * cost:
                fit = moved
            else:
                self.about = old
        return fit

    def reweighted(self, fit: Fit) -> Fit:
        """Weigh errors against what this fit leaves, put the nuisances where they belong, and measure it anew."""
        for _ in range(2):
            self.screen.comparison.temper(self.screen.runs, fit.predictions, self.screen.nominal, form(fit))
            fit, moved = self._fit_nuisances(self.remeasure(fit))
            if not moved:
                break
        return fit

    def reset_nuisances(self, fit: Fit) -> Fit:
        """Back to robots without deviations (the solver's and the sensors' stay): a gap is left all the same.

        Small deviations that were bent to imitate a cause would hide it from its own rivals.
        """
        straight = self._nuisances_of_sensors()
        if np.array_equal(straight, self.about):
            return fit
        self.about = straight
        fit = self.remeasure(fit)
        self.screen.comparison.temper(self.screen.runs, fit.predictions, self.screen.nominal, form(fit))
        return self.remeasure(fit)

    @contextmanager
    def nuisances_reset(self) -> Iterator[None]:
        """Fits in here are made as after `reset_nuisances`, under the present weights."""
        with self._beside(self._nuisances_of_sensors()):
            yield

    @contextmanager
    def _beside(self, about: F64) -> Iterator[None]:
        """Simulations in here contain these nuisances, whatever the search has come to since."""
        own, self.about = self.about, about
        try:
            yield
        finally:
            self.about = own

    def with_own_nuisances(self, fit: Fit, rounds: int = 4) -> Fit:
        """Causes and small deviations where they belong beside each other, found in turn; for this fit alone."""
        about, best = self.about, fit
        try:
            for _ in range(rounds):
                fit, moved = self._fit_nuisances(self.remeasure(fit))
                if moved and fit.causes:
                    fit = self.fit(fit.causes, iterations=3) or fit
                best = min(best, fit, key=lambda f: f.misfit)
                if not moved:
                    break
        except GapError:
            pass  # the robot falls beside other deviations: what was best until then counts
        finally:
            self.about = about
        return best

    def _nuisances_of_sensors(self) -> F64:
        staying = NUISANCES.keys() - LIKE_A_CAUSE
        return np.where([a.effect in staying for a in self.screen.atoms], self.about, 0.0)

    def remeasure(self, fit: Fit) -> Fit:
        """The same fit under the present weights and nuisances."""
        new = self._measure(fit.causes, None)
        return replace(new, covariance=fit.covariance, at_bounds=fit.at_bounds)

    def looked_at(self, fit: Fit, causes: Sequence[Cause]) -> Fit | None:
        """These causes at their very values, without a search, under the fit's weights; None if the robot falls."""
        return self._or_none(replace(fit, causes=tuple(causes)))

    def coarse_gain(self, causes: Sequence[Cause], further: Cause) -> float:
        """Gain in log-likelihood by a further cause at its very values, as a rough search sees it."""
        fidelity = self._fidelity([*causes, further], rough=True, coarse=True)
        candidates, z = [c.candidate for c in causes], [v for c in causes for v in c.values]
        before = self._misfit(candidates, np.array(z), fidelity)
        after = self._misfit([*candidates, further.candidate], np.array([*z, *further.values]), fidelity)
        return -np.inf if before is None or after is None else before - after

    def _fit_nuisances(self, fit: Fit) -> tuple[Fit, bool]:
        """Nuisances at their most probable values beside the causes, by simulation; whether they moved.

        They only move if that explains most of what is left: beside a large gap, many small deviations would be bent
        to imitate it.
        """
        x = deviations(self.screen, fit)
        x = np.where(self.screen.simulable & (np.abs(x) > 0.05 * fit.prior), x, 0.0)
        old, cost = self.about, self._cost(fit)
        for share in (1.0, 0.5):
            self.about = self.screen.possible(old + share * (x - old))
            moved = self._or_none(fit)
            if moved is not None and self._cost(moved) < (0.98 if old.any() else SETTLED) * cost:
                return moved, True
        self.about = old
        return fit, False

    def _or_none(self, fit: Fit) -> Fit | None:
        """`remeasure`, or None where the robot falls."""
        try:
            return self.remeasure(fit)
        except GapError:
            return None

    def _cost(self, fit: Fit) -> float:
        """Weighted squared residual of the simulation itself, and the nuisances' price."""
        total = float(np.sum((self.about[fit.prior > 0] / fit.prior[fit.prior > 0]) ** 2))
        for run, y in zip(self.screen.runs, fit.predictions, strict=True):
            r = self.screen.comparison.residual(run, y)
            total += float(np.nansum(self.screen.comparison.weights[run] * r**2))
        return total

    def fit(
        self,
        causes: Sequence[Cause],
        starts: Sequence[Sequence[float]] = (),
        iterations: int = 6,
        rough: bool = False,
        coarse: bool = False,
        target: float = np.inf,
        nearer: bool = False,
    ) -> Fit | None:
        """The best values near the causes' own and the further `starts` (all values in a row); None if none runs.

        A `rough` fit looks at some of the runs while it searches, and is measured on all of them; it is broken off
        once it would not come down to the misfit `target` (of the runs it looks at) at its present pace. A `coarse`
        one takes the screen's coarser time step while it searches. `nearer`: where a step gains nothing of what slopes
        promise, they are taken over narrower differences; what sticks and slips has dents that wide ones do not see.
        """
        candidates = [c.candidate for c in causes]
        parameters = self._parameters(candidates)
        fidelity = self._fidelity(causes, rough, coarse)
        first = [[v for c in causes for v in c.values], *starts]
        z = self._best_start(candidates, parameters, first, fidelity)
        if z is None and fidelity.coarse > 1:
            fidelity = Fidelity(fidelity.few)
            z = self._best_start(candidates, parameters, first, fidelity)
        if z is None:
            return None
        z, value, slopes = self._descend(candidates, z, None, parameters, fidelity, iterations, target, nearer)
        if fidelity.coarse > 1:
            fidelity = Fidelity(fidelity.few)
            if value <= target and self._predict(candidates, z, fidelity) is not None:
                z, value, slopes = self._descend(candidates, z, slopes, parameters, fidelity, POLISH)
        try:
            return self._measure(causes_of(candidates, z), parameters, slopes, fidelity)
        except GapError:  # on a run that a rough fit did not look at
            return None

    def left_out(self, fit: Fit, beside: F64) -> F64:
        """(runs,) half the weighted squares of each run, with values and deviations fitted to all the other runs.

        One Gauss-Newton step from the values that suit all runs leads to those that suit the others; the run that is
        left out is simulated with them.

        The simulations contain the nuisances that the fit was measured beside: its predictions do, and what moves by
        other nuisances would be taken for the runs' own.

        Args:
            beside: (p,) prior of a rival's deviations. What is a cause there is a deviation here, within reason.
        """
        with self._beside(fit.about):
            return self._left_out(fit, beside)

    def _left_out(self, fit: Fit, beside: F64) -> F64:
        screen, runs, m = self.screen, range(len(self.screen.runs)), sum(len(c.values) for c in fit.causes)
        candidates = [c.candidate for c in fit.causes]
        z, e = np.array([v for c in fit.causes for v in c.values]), fit.evidence
        A, b = list(e.A), list(e.b)
        parameters = self._parameters(candidates)
        slopes = self._slopes(candidates, z, parameters, list(fit.predictions)) if m else None
        prior = np.append(fit.prior, [4 * abs(p.step) for p in parameters]) if slopes else fit.prior
        if slopes:
            for k, D in enumerate(slopes):
                run = screen.runs[k]
                w = screen.comparison.weights[run].reshape(-1)
                r = np.nan_to_num(screen.residual(k, fit.predictions[k], fit.about - e.centre)).reshape(-1)
                across = screen.weighted(k).T @ D
                A[k] = np.block([[e.A[k], across], [across.T, D.T @ (w[:, None] * D)]])
                b[k] = np.append(e.b[k], D.T @ (w * r))
        found = []
        for k in runs:
            others = [i for i in runs if i != k]
            x, _ = posterior(np.sum([A[i] for i in others], axis=0), np.sum([b[i] for i in others], axis=0), prior)
            x, step = x[: len(fit.prior)], x[len(fit.prior) :]
            x = np.where((fit.prior > 0) & (beside == 0), reasonable(x, fit.prior), x)
            here, i = e, k
            if slopes:
                most = widest(z, parameters)
                moved = self._predict(
                    candidates, self._clip(z + np.clip(step, -most, most), parameters), Fidelity((k,))
                )
                if moved is not None:
                    here, i = screen.evidence(moved, (k,), fit.about), 0
                    here = here.moved(np.full(len(fit.prior), e.centre) - here.centre)
            b_k, A_k = here.b[i], here.A[i]
            found.append(0.5 * float(here.c[i] - 2 * b_k @ x + x @ A_k @ x))
        return np.array(found)

    def spread(self, fit: Fit) -> Fit:
        """The same fit with its covariance from slopes taken at its very values."""
        if not fit.causes:
            return fit
        return self._measure(fit.causes, self._parameters([c.candidate for c in fit.causes]), None)

    # ------------------------------------------------------------ inside

    def _measure(
        self,
        causes: tuple[Cause, ...],
        parameters: list[Parameter] | None,
        slopes: list[F64] | None = None,
        fidelity: Fidelity = FULL,
    ) -> Fit:
        """The fit with its evidence; `slopes` (of the runs looked at) are taken by differences if there are none."""
        candidates = [c.candidate for c in causes]
        z = np.array([v for c in causes for v in c.values])
        prior = self.prior_beside(candidates)
        predicted = self._predict(candidates, z)
        if predicted is None:
            raise GapError("the simulator fails with the values found", hint="look at the units of the log")
        about = self._about(candidates)
        evidence = self.screen.evidence(predicted, None, about)
        covariance = np.zeros((len(z), len(z)))
        at_bounds: list[str] = []
        if parameters:
            if slopes is None:
                slopes, fidelity = self._slopes(candidates, z, parameters, predicted), FULL
            if slopes is not None:
                seen = predicted if fidelity.few is None else [predicted[k] for k in fidelity.few]
                covariance = spread(*self._local(candidates, seen, slopes, fidelity), parameters)
            at_bounds = [p.name for p, v in zip(parameters, z, strict=True) if _at_bound(p, float(v))]
        misfit = self.screen.misfit(evidence, prior)
        return Fit(causes, misfit, covariance, tuple(predicted), about, evidence, prior, tuple(at_bounds))


def _at_bound(p: Parameter, value: float) -> bool:
    """Whether a value lies at an end of its range; zero, where an effect begins, and nothing left of it are no ends."""
    low, high = p.bounds
    near = min(1e-3 * (high - low), 0.05 * abs(p.step))
    return value >= high - near or (low != 0 and not p.none_left and value <= low + near)
