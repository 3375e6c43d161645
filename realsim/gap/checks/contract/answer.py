"""Was the policy run as its contract says? The search at the log's rates, the servos' gains, and one sentence."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.gap.checks.contract.loop import Loop, targets
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.proposals import AGES
from realsim.gap.checks.contract.search import Problem, Trial, search
from realsim.gap.checks.contract.servo import check_gains
from realsim.gap.checks.contract.settings import setting
from realsim.gap.checks.contract.steps import LEAST, Steps, at_changes, every, liveliest

ROWS, ROWS_WITH_CAMERA = 300, 120
"""Policy steps that the search looks at: with twelve joints some 4,000 equations."""
KEPT = 0.1
"""Share of the targets' spread (rms) up to which the policy explains them: what noise of the log's own sensors leaves
under random networks is below 0.06 (benchmarks/diagnosis/contract.py, seeds below 100)."""
BLIND = 0.25
"""Share of the targets' spread that a term which is not logged is taken to leave open; set by hand."""
STILL = 0.01
"""rad: targets that move less (rms) show nothing of the policy but its rest."""
OTHER_PERIOD = 0.1
"""Relative difference of the period from the contract's: clocks and jitter of loops stay below."""


@dataclass(frozen=True)
class Found:
    """The answer."""

    verdict: str
    """`kept`, `broken`, `ambiguous` (several mistakes explain it), `unexplained`, or `still` (the log cannot tell)."""
    sentence: str
    errors: tuple[dict[str, Any], ...]
    """{kind, text, left, setting, or}: mistakes one after the other, and what is left of the spread when all up to it
    are mended; `or` are other kinds that explain as much."""
    left: float
    """Share of the targets' spread (rms) that the contract itself leaves."""
    after: float
    """The same with all mistakes mended."""
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def check(contract: Contract, steps: Steps) -> Found:
    """Compare what was sent with what the policy would have sent, and find what has to differ for both to agree.

    Raises:
        GapError: the policy moves joints that the log does not have, or its history is longer than the log.
    """
    other = [j for j in contract.joints if j not in steps.joints]
    if other:
        raise GapError(
            "the policy is for another robot, or its joints have other names",
            expected=", ".join(steps.joints), found=", ".join(other),
            hint="give the policy that ran in the log, or call joints in log.json and model.xml what it calls them",
        )  # fmt: skip
    notes = list(steps.notes)
    rates = list(_rates(contract, steps, notes))
    problem = min(rates, key=lambda p: p.left(Loop()))
    moves, left = float(np.sqrt(np.mean(problem.spread**2))), problem.left(Loop())
    if moves < STILL and left < 0.5:
        text = (
            f"The log cannot tell: the targets move by {1e3 * moves:.1f} mrad. Nothing contradicts the contract; "
            "record a run in which the policy walks."
        )
        return Found("still", text, (), left, left, tuple(notes))
    problem = _blank(problem, notes)
    start = Loop()
    right = problem.left(start)
    loop, taken = search(problem, start)
    # Under a broken contract alone another rate may leave less than the right one: beside what was found it does not.
    timeless = replace(loop, age={}, stale=None)
    better = min(rates, key=lambda p: p.left(timeless))
    if better.left(timeless) < problem.left(loop):
        problem = _blank(better, [])
        right = problem.left(start)
        loop, taken = search(problem, start)
    after, noise = problem.left(loop), max(KEPT, problem.open)
    explained = after <= noise or after < 0.3 * right
    errors = _errors(problem, start, taken, notes) + _outside(contract, problem.steps, steps, explained)
    verdict, sentence = _worded(errors, right, after, explained, noise)
    if verdict == "kept" and (never := _never_commanded(problem)):
        sentence += f" It was never commanded {' or '.join(never)}: whether these reach it is not checked."
    return Found(verdict, sentence, () if verdict == "kept" else tuple(errors), right, after, tuple(notes))


def _rates(contract: Contract, steps: Steps, notes: list[str]) -> Iterator[Problem]:
    """The log at the rates at which its policy may have run: as logged, where commands change, at its own."""
    # Between two changes a command stays constant: such rows are no policy steps, yet a broken contract may fit them.
    held = steps.changes > 1.5 * steps.period
    found = [at_changes(steps, 0), at_changes(steps, 1)] if held else [steps]
    count = round(contract.period / steps.period)
    if count > 1:
        found.append(every(steps, count))
    least = contract.history + LEAST
    long = [replace(s, runs=tuple(r for r in s.runs if len(r.time) >= least)) for s in found]
    if not any(s.runs for s in long):
        raise GapError(
            "the policy's history is longer than the log", expected=f"a run of at least {least} policy steps",
            found=f"{max(len(r.time) for r in steps.runs)} at most", hint="record longer runs without gaps",
        )  # fmt: skip
    short = {r.name for r in steps.runs} - {r.name for s in long for r in s.runs}
    if short:
        notes.append(f"runs too short for the policy's history are left out: {', '.join(sorted(short)[:3])}")
    rows = ROWS if contract.camera is None else ROWS_WITH_CAMERA
    half = max(
        rows // 2 + contract.memory - contract.history + int(AGES[-1]), least
    )  # images from before are no rows to judge
    return (Problem(contract, liveliest(s, 2 * half, half)) for s in long if s.runs)


def _blank(problem: Problem, notes: list[str]) -> Problem:
    """With the blank image that fits best, and the share of the spread that inputs which are not logged leave open."""
    contract, steps = problem.contract, problem.steps
    kinds = {t.kind for t in contract.terms}
    blind = [t.name for t in contract.terms if t.kind == "unknown"]
    if all(r.lin_vel is None for r in steps.runs):
        blind = [t.name for t in contract.terms if t.kind in ("unknown", "lin_vel")]
    if "command" in kinds and all(r.commanded is None for r in steps.runs):
        notes.append("the velocity command is not logged (policy_command): it is estimated five times a second")
    if blind:
        notes.append(f"not logged, taken as zero: {', '.join(blind)}; the other terms are checked")
    if contract.camera is None or any(r.frames is not None for r in steps.runs):
        problem.open = BLIND if blind else 0.0
        return problem
    tried = [Problem(contract, steps, blank) for blank in (1.0, 0.75, 0.5, 0.25, 0.0)]
    best = min(tried, key=lambda p: p.left(Loop()))
    replayed = [np.concatenate(targets(contract, p.steps, Loop())) for p in tried]
    here = replayed[tried.index(best)]
    typical = np.median([np.sqrt(np.mean((r - here) ** 2)) for r in replayed])
    apart = float(typical / np.sqrt(np.mean(problem.spread**2)))
    notes.append(
        f"the camera is checked by no frame: a blank image stands for it, which leaves about {apart:.0%} of the "
        "targets' spread open; the other terms are checked"
    )
    best.open = min(apart, 0.7)
    return best


def _never_commanded(problem: Problem) -> list[str]:
    """Parts of the velocity command that are zero all along a log: no mistake in them leaves a trace."""
    commands = [r.commanded for r in problem.steps.runs if r.commanded is not None]
    if not commands or all(t.kind != "command" for t in problem.contract.terms):
        return []
    most = np.abs(np.concatenate(commands)).max(axis=0)
    return [word for word, value in zip(("ahead", "left", "to turn"), most, strict=True) if value == 0]


def _errors(problem: Problem, start: Loop, taken: list[Trial], notes: list[str]) -> list[dict[str, Any]]:
    loop, found = start, []
    for trial in taken:
        loop = trial.applied(loop)
        if trial.kind == "timing":
            notes.append(trial.text)
            continue
        kinds = {r.kind: {"kind": r.kind, "text": r.text} for r in reversed(trial.rivals)}  # the best of each
        rivals = [r for kind, r in kinds.items() if kind not in (trial.kind, "timing")]
        found.append(_error(problem.contract, trial.kind, trial.text, problem.left(loop), rivals))
    return found


def _error(
    contract: Contract, kind: str, text: str, left: float | None = None, rivals: Sequence[dict[str, str]] = ()
) -> dict[str, Any]:
    """See `Found.errors`."""
    what = setting(kind, contract.framework)
    return {"kind": kind, "text": text, "left": left, "setting": what, "or": list(rivals)}


def _outside(contract: Contract, used: Steps, steps: Steps, explained: bool) -> list[dict[str, Any]]:
    """What no residual of targets shows: the period, where the replay agrees at the rate it has, and the gains."""
    found = []
    period = float(np.median([np.median(np.diff(r.time)) for r in used.runs]))
    if explained and abs(period / contract.period - 1) > OTHER_PERIOD:
        text = f"the policy is asked every {1e3 * period:.3g} ms instead of every {1e3 * contract.period:.3g} ms"
        if steps.period > 1.5 * contract.period:
            text += " (unless the log leaves out steps)"
        found.append(_error(contract, "control_period", text))
    gains = check_gains(contract, steps if steps.period <= contract.period * 1.5 else used)
    return [*found, _error(contract, "gains", gains)] if gains else found


def _worded(
    errors: Sequence[dict[str, Any]], right: float, after: float, explained: bool, noise: float
) -> tuple[str, str]:
    """(verdict, sentence)."""
    words = [" or ".join([e["text"], *(o["text"] for o in e["or"])]) for e in errors]
    if not explained:
        near = f"; nearest: {words[0]}" if words else ""
        return "unexplained", (
            f"The targets that were sent are not the policy's: {right:.0%} of their spread is left, and {after:.0%} "
            f"with every mistake that the search knows{near}. Is it this policy?"
        )
    if not errors:
        open_ = "" if noise <= KEPT else f" Up to {noise:.0%} may come from inputs that are not logged."
        left = f"{right:.1%} of its targets' spread is left"
        return "kept", f"The policy was run as its contract says: {left}.{open_}"
    which = "; ".join(f"({i}) {w}" for i, w in enumerate(words, 1)) if len(words) > 1 else words[0]
    sentence = f"The policy's contract is broken: {which}."
    if any(e["left"] is not None for e in errors):
        rest = "" if after <= noise else f", and something that the search does not know leaves {after:.0%}"
        sentence += f" As trained, {right:.0%} of the targets' spread is left; with this mended {after:.1%}{rest}."
    return "ambiguous" if any(e["or"] for e in errors) else "broken", sentence
