"""What changed since an earlier log of the same robot, by how much, and how sure that is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student
from threadpoolctl import threadpool_limits

from realsim.core.statistics import Z90
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.answer.diagnosis import MODEL_ERROR
from realsim.gap.case.case import Case
from realsim.gap.config import DiagnoseConfig
from realsim.gap.drift.change import DAILY, Changed, Joint
from realsim.gap.drift.pair import pair_of
from realsim.gap.drift.words import sentence
from realsim.gap.effects.lookup import lookup
from realsim.gap.inference.causes.fit import Fitter
from realsim.gap.inference.causes.fitted import Cause
from realsim.gap.inference.causes.leftover import is_gap
from realsim.gap.inference.causes.score import determined
from realsim.gap.inference.causes.select import Selection, select
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.free_starts import free_starts
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Simulator

HOLDS, MOST_RUNS = 0.5, 0.6
"""Standard errors, and share of the runs, by which a change must gain on runs left out in turn."""
CERTAIN = 0.975
"""Quantile of Student's t that a preference on runs left out must exceed to tell two changes apart. Conventional."""
EQUAL, EQUAL_SHARE = 8.0, 0.03
"""Nats, and share of what both remove, within which two changes explain the later log alike."""
FINALISTS = 6
"""Possible changes that are fitted by simulation: a budget."""
SURE = 2.0
"""Standard errors that a change must lie off nothing, as a cause of a diagnosis must."""
WORSE = 2.0
"""Times the earlier log's rest beside causes that the later one's must be to say that something stays unexplained."""


@dataclass(frozen=True)
class Since:
    """What changed. `as_dict` is `since` of diagnosis.json."""

    verdict: str
    """`unchanged`, `identified`, `ambiguous` or `unexplained`."""
    sentence: str
    changes: tuple[dict[str, Any], ...]
    """`effect`, `joints` or `bodies`, `parameters`: {name: {`before`, `now`, `change`, `unit`, `ci90` of the change}}.
    The change of a ratio is a ratio."""
    equivalent: tuple[tuple[dict[str, Any], ...], ...]
    """Other sets of changes that explain the later log as well."""
    statistics: dict[str, Any]
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        found = asdict(self)
        return found | {"changes": list(self.changes), "equivalent": [list(s) for s in self.equivalent]}


def changed_since(
    today: Case,
    before: Case,
    config: DiagnoseConfig | None = None,
    tick: Callable[[str, float], None] = lambda what, share: None,
) -> Since:
    """Which cause changed between two logs of one robot.

    Args:
        today, before: cases against the same model, from `load_case`; with different ones, today's is used for both.

    Raises:
        GapError: where the logs are not of one robot, or one cannot support a diagnosis.
    """
    config = config or DiagnoseConfig()
    pair = pair_of(today, before, config)
    fitted = [*pair.before, *pair.now]
    with threadpool_limits(1, user_api="blas"), Simulator(pair.case, config, fitted) as simulator:
        nominal = simulator.simulate()
        comparison = Comparison(pair.case, simulator.channels, nominal, config, fitted)
        free_starts(simulator, comparison)
        earlier = Screen(simulator, comparison, pair.before, config.effects, tick)
        shared = select(earlier, Fitter(earlier), config, tick)
        screen = Screen(simulator, comparison, fitted, config.effects, tick)
        joint = _joint(screen, shared, nominal, len(pair.before))
        found, stages, notes = _search(joint, config, tick)
        rivals = _rivals(joint, config, found, stages)
        then, now = joint.left(found)
        _, first_now = joint.left(joint.nothing())
        stays = _stays(config, bool(found.causes), then, first_now, now)
        verdict = "unexplained" if stays else "ambiguous" if rivals else "identified" if found.causes else "unchanged"
        changes = _described(joint, found)
        others = [_described(joint, r) for r in rivals]
        statistics = {
            "left_before": float(then.mean()),
            "left_now": float(now.mean()),
            "left_now_without_change": float(first_now.mean()),
            "shared": [[c.candidate.effect, *c.candidate.place] for c in shared.fit.causes],
            "runs_before": [pair.case.runs[i].name for i in pair.before],
            "runs_now": [pair.case.runs[i].name for i in pair.now],
        }
        said = sentence(verdict, changes, others)
        return Since(verdict, said, tuple(changes), tuple(map(tuple, others)), statistics, (*pair.notes, *notes))


def _stays(config: DiagnoseConfig, named: bool, then: F64, first: F64, now: F64) -> bool:
    """Whether the later log shows more than the changes explain: by the rules of a diagnosis, beside the earlier log.

    Args:
        then, first, now: mean squares by run in units of the floor: the earlier log's rest, the later one's without the
            changes, and with them.
    """
    if not named:
        return is_gap(now / figures.EXCESS) and float(np.median(now)) > WORSE * max(float(np.median(then)), 1.0)
    share = float(np.mean(np.maximum(now - 1, 0))) / max(float(np.mean(first - 1)), 1e-9)
    return (is_gap(now) and share > config.unexplained_share) or float(np.median(now)) > figures.EXPLAINED


def _joint(screen: Screen, shared: Selection, nominal: Sequence[F64], earlier: int) -> Joint:
    """Slopes about the causes of both logs, errors weighed against what is left beside them."""
    simulator, comparison = screen.simulator, screen.comparison
    settings = shared.fit.settings()
    if settings:
        screen.relinearise(settings)
    form = max((lookup(c.candidate.effect).law.form for c in shared.fit.causes), default=0.0)
    predictions = simulator.simulate(settings, runs=screen.runs)
    comparison.temper(screen.runs, predictions, [nominal[i] for i in screen.runs], form)
    return Joint(screen, shared.fit.causes, shared.fit.covariance, range(earlier, len(screen.runs)))


Stage = tuple[Changed, list[Changed]]
"""(changes so far, fits with one more, the best first)."""


def _search(
    joint: Joint, config: DiagnoseConfig, tick: Callable[[str, float], None]
) -> tuple[Changed, list[Stage], list[str]]:
    """Change after change, as long as one more is called for."""
    current, stages, notes = joint.nothing(), [], []
    for k in range(config.max_causes):
        tick(f"changes, {k + 1}", k / config.max_causes)
        fits = _refitted(joint, config, current)
        best = next((f for f in fits if not _doubt(joint, config, current, f)), None)
        if best is None:
            if fits:
                c = fits[0].causes[-1].candidate
                notes.append(
                    f"{' '.join([c.effect, *c.place])} is no change: {_doubt(joint, config, current, fits[0])}"
                )
            break
        stages.append((current, fits))
        current = best
    return current, stages, notes


def _refitted(joint: Joint, config: DiagnoseConfig, current: Changed) -> list[Changed]:
    """The changes that slopes speak for, fitted beside those that are known; the best first."""
    fits: list[Changed] = []
    seen: set[tuple[str, tuple[str, ...]]] = set()
    for gain, candidate, estimate in joint.ranked(current):
        if gain < figures.CLEARLY or len(seen) == FINALISTS:
            break
        key = (candidate.effect, candidate.place)
        shapes = {p.name for p in candidate.parameters if p.shape}  # a mass begins at its body's centre
        guess = {n: float(v) for n, v in zip(candidate.linear, estimate, strict=True) if n not in shapes}
        if guess.keys() | shapes != set(candidate.names) or key in seen or sum(e == key[0] for e, _ in seen) == 2:
            continue
        seen.add(key)
        start = Cause(candidate, tuple(guess.get(n, 0.0) for n in candidate.names))
        fit = joint.fit([*current.causes, start])
        if fit is not None:
            fits.append(fit)
    for fit in sorted(fits, key=_price)[:2]:  # with all its parameters a change may do what the simple form cannot
        last = fit.causes[-1]
        for c in joint.screen.candidates:
            if (c.effect, c.places) == (last.candidate.effect, last.candidate.places) and len(c.names) > len(
                last.values
            ):
                more = joint.fit([*fit.causes[:-1], Cause(c, tuple(last.named.get(n, 0.0) for n in c.names))])
                if more is not None:
                    fits.append(more)
    return sorted(fits, key=_price)


def _price(fit: Changed) -> float:
    return fit.misfit + figures.PRICE * determined(fit)


def _doubt(joint: Joint, config: DiagnoseConfig, before: Changed, after: Changed) -> str:
    """Why the last change of a fit is not believed; empty if it is."""
    cause = after.causes[-1]
    gain = before.misfit - after.misfit
    # A change costs what a cause costs (`realsim.gap.inference.causes.score`).
    joints = len(joint.screen.simulator.case.joint_names)
    least = figures.CLEARLY + figures.CAUSE + figures.CAUSE_A_JOINT * joints
    least += figures.PRICE * (determined(after) - determined(before))
    if gain < least:
        return f"it gains {gain:.1f} nats, must gain {least:.1f}"
    parameters = cause.candidate.parameters
    errors = np.sqrt(np.maximum(np.diag(after.covariance), 1e-30))[-len(cause.values) :]
    rows = [(abs(v), e, p) for v, e, p in zip(cause.values, errors, parameters, strict=True) if p.strength]
    if max((v / e for v, e, _ in rows), default=0.0) < SURE:
        return "too few standard errors off nothing"
    if max((v / (DAILY * p.nuisance or 0.1 * abs(p.step)) for v, _, p in rows), default=0.0) < figures.REASONABLE:
        return "no larger than what comes and goes from day to day"
    gains = joint.gains(before, after)
    if len(gains) > 1:  # of a single run none can be left out
        error = float(gains.std(ddof=1) / np.sqrt(len(gains)))
        if gains.mean() <= HOLDS * error or (gains > 0).mean() < MOST_RUNS:
            return "does not hold on runs left out in turn"
    return ""


def _rivals(joint: Joint, config: DiagnoseConfig, found: Changed, stages: Sequence[Stage]) -> list[Changed]:
    """Other sets that explain the later log as well: the last change exchanged."""
    if not stages:
        return []
    before, fits = stages[-1]
    removed = before.misfit - found.misfit
    rivals: dict[tuple, Changed] = {}
    for fit in fits:
        key = (fit.causes[-1].candidate.effect, fit.causes[-1].candidate.place)
        if key == (found.causes[-1].candidate.effect, found.causes[-1].candidate.place) or key in rivals:
            continue
        loss = _price(fit) - _price(found)
        gains = joint.gains(fit, found)
        error = float(gains.std(ddof=1) / np.sqrt(len(gains))) if len(gains) > 1 else np.inf
        preferred = gains.mean() > float(student.ppf(CERTAIN, max(len(gains) - 1, 1))) * error
        alike = loss < figures.CLEARLY or (loss < max(EQUAL_SHARE * removed, EQUAL) and not preferred)
        if alike and not _doubt(joint, config, before, fit):
            rivals[key] = fit
    return list(rivals.values())


def _described(joint: Joint, found: Changed) -> list[dict[str, Any]]:
    """Changes in the contract's form."""
    errors = list(np.sqrt(np.maximum(np.diag(found.covariance), 0.0)))
    said = []
    for cause in found.causes:
        c = cause.candidate
        start, parameters = joint.before(c), {}
        for p, value in zip(c.parameters, cause.values, strict=True):
            own = MODEL_ERROR * value if p.strength else 0.0
            sigma = float(np.sqrt(errors.pop(0) ** 2 + (DAILY * p.nuisance) ** 2 + own**2))
            known = p.strength or joint.has(c)
            parameters[p.name] = _parameter(p, start[p.name] if known else np.nan, start[p.name], value, sigma)
        entry: dict[str, Any] = {"effect": c.effect}
        scope = lookup(c.effect).scope
        if scope == "joint":
            entry["joints"] = list(c.place)
        elif scope in ("body", "terrain"):
            entry["bodies"] = list(c.place)
        said.append(entry | {"parameters": parameters})
    return said


def _parameter(p: Any, before: float, start: float, value: float, sigma: float) -> dict[str, Any]:
    """Before, now and the change with its interval, in reported units; None where there was nothing before.

    Args:
        before: coordinate in the earlier log; NaN for the place of a mass that was not there.
    """

    def report(coordinate: float) -> float:
        return float(p.report(float(np.clip(coordinate, *p.bounds))))

    before, now = report(before), report(start + value)
    ends = sorted(report(start + value + s * Z90 * sigma) for s in (-1, 1))
    found: dict[str, Any] = {"before": before if np.isfinite(before) else None, "now": now, "unit": p.unit}
    if not np.isfinite(before):
        return found | {"change": None, "ci90": None, "now_ci90": ends}
    if p.unit == "ratio" and before > 0 and p.report(0.0) == 1.0:
        return found | {"change": now / before, "ci90": [e / before for e in ends]}
    return found | {"change": now - before, "ci90": [e - before for e in ends]}
