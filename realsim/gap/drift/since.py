"""What changed since an earlier log of the same robot, by how much, and how sure that is.

The earlier log's causes are found first, and hold for both. Then the search of a diagnosis looks for causes that only
the later log has: about those of both, r = G x + [later] G d + [later] H c + e, with everyday deviations x that stay,
small ones d that come from day to day, and a change c of one effect at one place.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from realsim.core.statistics import Z90
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.answer.conclusion import beside_imitations
from realsim.gap.answer.diagnosis import MODEL_ERROR
from realsim.gap.answer.leaveout import leave_out
from realsim.gap.answer.sentence import CUT_SHORT, number
from realsim.gap.case.case import Case
from realsim.gap.config import DiagnoseConfig
from realsim.gap.drift.pair import pair_of
from realsim.gap.effects import EFFECTS
from realsim.gap.effects.base import Parameter
from realsim.gap.effects.lookup import PLACES, SINCE, lookup, places_of
from realsim.gap.inference.causes.fit import Fitter
from realsim.gap.inference.causes.fitted import Cause, Fit, imitates, is_gap, leftover, with_errors
from realsim.gap.inference.causes.select import select
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.free_starts import free_starts
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Simulator

SHARED_STEPS = 2.0
"""Standard deviations of its fit by which a value that both logs share may still move: one log alone gave it."""
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
        comparison = Comparison(pair.case, simulator.channels, simulator.simulate(), config, fitted)
        free_starts(simulator, comparison)
        simulator.stop_after(30 * config.time_limit)  # half of it
        earlier = Screen(simulator, comparison, pair.before, config.effects, tick)
        common = select(Fitter.of(earlier), config, tick)
        # Of what only imitates both logs may have as much as they like; a robot that has it would hide a change.
        shared = common.nominal if imitates(common.fit) else common.fit
        simulator.stop_after(30 * config.time_limit)
        simulator.begin_from(shared.settings())
        screen = Screen(simulator, comparison, fitted, config.effects, tick, since=True)
        _loosen(screen, common.fit, shared is common.fit)
        found = select(Fitter.of(screen), config, tick)
        simulator.stop_after(np.inf)
        cut_short = common.cut_short or found.cut_short
        fit, notes, fitter = found.fit, list(found.notes), found.fitter
        if doubts := [d for c, sigmas in with_errors(fit) if (d := _doubt(c, sigmas))]:
            fit, notes = found.nominal, notes + doubts
        rivals: list[Fit] = []
        if fit.causes:
            left = leave_out(fitter, fit)
            fit, _, rivals = beside_imitations(fitter, fit, left, found.equivalent, notes)
            rivals = [f for f in map(fitter.spread, rivals) if not any(_doubt(*c) for c in with_errors(f))]
        then, first, now = _split(pair.before, leftover(screen, found.nominal), leftover(screen, fit))
        unexplained = _stays(config, bool(fit.causes), then, first, now)
        verdict = (
            "unexplained"
            if unexplained
            else "ambiguous"
            if rivals or (cut_short and fit.causes)
            else "identified"
            if fit.causes
            else "unchanged"
        )
        changes, *others = (_described(shared, f) for f in (fit, *rivals))
        statistics = {
            "left_before": float(then.mean()),
            "left_now": float(now.mean()),
            "left_now_without_change": float(first.mean()),
            "shared": [[c.candidate.effect, *c.candidate.place] for c in shared.causes],
            "runs_before": [pair.case.runs[i].name for i in pair.before],
            "runs_now": [pair.case.runs[i].name for i in pair.now],
        }
        text = sentence(verdict, changes, others) + (f" {CUT_SHORT}" if cut_short else "")
        return Since(verdict, text, tuple(changes), tuple(map(tuple, others)), statistics, (*pair.notes, *notes))


def _loosen(screen: Screen, shared: Fit, there: bool) -> None:
    """Let the values that both logs share move by what the earlier log alone left open; where they are not `there`, in
    every simulation, from none."""
    for cause, sigmas in with_errors(shared):
        c = cause.candidate
        for p, value, error in zip(c.parameters, cause.values, sigmas, strict=True):
            sigma = error if there else error + abs(value - p.default)
            for i in screen.atoms_of(type(c)(c.effect, c.places, (p,), c.directions, ())):
                screen.prior[i] = max(screen.prior[i], SHARED_STEPS * sigma)


def _split(before: tuple[int, ...], first: F64, now: F64) -> tuple[F64, F64, F64]:
    """What stays by run: the earlier log's, the later one's without the changes, and with them."""
    n = len(before)
    return now[:n], first[n:], now[n:]


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


def _doubt(cause: Cause, errors: F64) -> str:
    """Why a change is not believed; empty if it is."""
    rows = [r for r in zip(cause.candidate.parameters, cause.values, errors, strict=True) if r[0].strength]
    name = " ".join([cause.candidate.effect.removesuffix(SINCE), *cause.candidate.place])
    if max((abs(v) / max(e, 1e-15) for _, v, e in rows), default=0.0) < SURE:
        return f"{name} is no change: too few standard errors off nothing"
    if max((abs(v) / (p.nuisance or 0.1 * abs(p.step)) for p, v, _ in rows), default=0.0) < figures.REASONABLE:
        return f"{name} is no change: no larger than what comes and goes from day to day"
    return ""


def _described(shared: Fit, found: Fit) -> list[dict[str, Any]]:
    """Changes in the contract's form."""
    listed = []
    for cause, errors in with_errors(found):
        c, name, parameters = cause.candidate, cause.candidate.effect.removesuffix(SINCE), {}
        known: dict[str, float] = {}
        for other in shared.causes:
            if other.candidate.effect == name and set(c.places) <= set(other.candidate.places):
                known |= other.named
        for p, value, error in zip(c.parameters, cause.values, errors, strict=True):
            own = MODEL_ERROR * value if p.strength else 0.0
            sigma = float(np.sqrt(error**2 + p.nuisance**2 + own**2))
            start = known.get(p.name, p.default)
            before = start if p.strength or known else np.nan
            parameters[p.name] = _parameter(p, before, start, value - p.default, sigma)
        places = {key: list(c.place)} if (key := PLACES.get(lookup(name).scope)) else {}
        listed.append({"effect": name, **places, "parameters": parameters})
    return listed


def _parameter(p: Parameter, before: float, start: float, change: float, sigma: float) -> dict[str, Any]:
    """Before, now and the change with its interval, in reported units; None where there was nothing before.

    Args:
        before: coordinate in the earlier log; NaN for the place of a mass that was not there.
    """

    def report(coordinate: float) -> float:
        return float(p.report(float(np.clip(coordinate, *p.bounds))))

    before, now = report(before), report(start + change)
    ends = sorted(report(start + change + s * Z90 * sigma) for s in (-1, 1))
    found: dict[str, Any] = {"before": before if np.isfinite(before) else None, "now": now, "unit": p.unit}
    if not np.isfinite(before):
        return found | {"change": None, "ci90": None, "now_ci90": ends}
    if p.unit == "ratio" and before > 0 and p.report(0.0) == 1.0:
        return found | {"change": now / before, "ci90": [e / before for e in ends]}
    return found | {"change": now - before, "ci90": [e - before for e in ends]}


Change = dict[str, Any]


def sentence(verdict: str, changes: Sequence[Change], equivalent: Sequence[Sequence[Change]]) -> str:
    """The verdict as one sentence."""
    if verdict == "unchanged":
        return "Nothing changed that these two logs can show, beyond what comes and goes from day to day."
    text = "; ".join(phrase(c) for c in changes)
    if verdict == "ambiguous":
        either = ", or ".join("; ".join(phrase(c) for c in s) for s in (changes, *equivalent))
        return f"Something changed, and cannot tell what: {either}."
    if verdict == "unexplained":
        near = f" The nearest is {text}: it may only imitate the change." if changes else ""
        return f"Something changed that no effect of this library explains.{near}"
    hints = [by for c in changes if (by := EFFECTS[c["effect"]].words.changed_by)]
    return f"{text}{f' (often {hints[0]})' if len(hints) == 1 == len(changes) else ''}."


def phrase(change: Change) -> str:
    """elbow: Coulomb friction grew by 0.31 N m [0.26, 0.36], from 0 to 0.31."""
    title = EFFECTS[change["effect"]].title
    names = ", ".join(places_of(change))
    every, place = change["parameters"], ""
    if all(a in every and every[a]["change"] is None for a in "xyz"):  # where a mass sits that was not there
        place = f" at ({', '.join(number(round(every[a]['now'], 3)) for a in 'xyz')}) m"
        every = {n: p for n, p in every.items() if n not in ("x", "y", "z")}
    parts = [_amount(name, p, len(every) > 1) for name, p in every.items()]
    parts[-1] += place
    return f"{names}: {title} {', '.join(parts)}" if names else f"{title} {', '.join(parts)}"


def _amount(name: str, p: dict[str, Any], named: bool) -> str:
    label = f"{name.replace('_', ' ')} " if named else ""
    unit = "" if p["unit"] == "ratio" else f" {p['unit']}"
    if p["change"] is None:
        low, high = p["now_ci90"]
        return f"{label}is now {number(p['now'])}{unit} [{number(low)}, {number(high)}]"
    low, high = p["ci90"]
    if p["unit"] == "ratio" and p["before"] > 0 and abs(p["change"] - p["now"] / p["before"]) < 1e-9:
        return f"{label}is {number(p['change'])} times [{number(low)}, {number(high)}] what it was"
    grew, sign = ("grew", 1) if p["change"] >= 0 else ("fell", -1)
    low, high = sorted((sign * low, sign * high))
    ends = f"from {number(p['before'])} to {number(p['now'])}"
    return f"{label}{grew} by {number(sign * p['change'])}{unit} [{number(low)}, {number(high)}], {ends}"
