"""Finds the way of running the policy that explains the sent targets: as in the contract, or with a mistake."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.checks.contract.kinds import KINDS, Hypothesis, residual
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.replay import Mistake
from realsim.gap.checks.contract.steps import Steps, at_changes

FLOOR = 0.02
"""Share of the targets' spread that sensor noise leaves in any log."""
KEPT = 0.1
"""Share of the targets' spread up to which the policy, run as it should be, explains them."""
BETTER = 0.5
"""A mistake must leave at most this share of what the contract leaves."""
EXPLAINED = 0.3
"""And at most this share of the targets' spread."""
APART = 0.8
"""Two kinds that leave amounts nearer than this ratio cannot be told apart."""
GAIN_OFF = 0.2
"""Relative difference of a servo's gain from the contract's."""
SURE = 0.9
"""Share of the torque's square that the servo's law must explain before its gains are believed."""

# All figures above were set on logs of the simulated quadruped with seeds below 100 (benchmarks/diagnosis/contract.py).


@dataclass(frozen=True)
class Found:
    """The answer."""

    verdict: str
    """`kept`, `broken`, `ambiguous` (several mistakes explain it), `unexplained`."""
    sentence: str
    errors: tuple[dict[str, Any], ...]
    """{kind, text, left}, best first: the mistakes that explain the targets."""
    left: float
    """Share of the targets' spread (rms) that the contract itself leaves."""
    table: tuple[dict[str, Any], ...]
    """Every hypothesis, best first."""

    def as_dict(self) -> dict[str, Any]:
        return {"verdict": self.verdict, "sentence": self.sentence, "errors": list(self.errors), "left": self.left,
                "hypotheses": list(self.table)}  # fmt: skip


def check(contract: Contract, steps: Steps) -> Found:
    """Compare what was sent with what the policy would have sent, rightly run and wrongly run.

    All rows are policy steps where the log runs at the policy's rate; of a faster log, those in which the command
    changes, and what was seen is the row before or the same, whichever the contract explains better.

    Raises:
        GapError: the policy moves joints that the log does not have.
    """
    other = [j for j in contract.joints if j not in steps.joints]
    if other:
        raise GapError(
            "the policy is for another robot, or its joints have other names",
            expected=", ".join(steps.joints),
            found=", ".join(other),
        )
    steps = _at_policy_rate(contract, steps)
    right = _left(contract, steps, Mistake())
    tried = [h for kind in KINDS.values() for h in kind(contract, steps)]
    scored = sorted(((_left(contract, h.steps, h.mistake), i) for i, h in enumerate(tried)))
    table: list[dict[str, Any]] = [{"kind": tried[i].kind, "text": tried[i].text, "left": left} for left, i in scored]
    gains = _gains(contract, steps)
    good = [t for t in table if right > FLOOR and t["left"] < min(BETTER * right, EXPLAINED)]
    if not good and right <= KEPT:
        if gains:
            return Found("broken", f"The policy's contract is broken: {gains['text']}.", (gains,), right, tuple(table))
        return Found("kept", f"The policy was run as its contract says: {right:.1%} of its targets' spread is left.",
                     (), right, tuple(table))  # fmt: skip
    if not good:
        return Found(
            "unexplained",
            f"The targets that were sent are not the policy's ({right:.0%} of their spread is left), and no mistake "
            f"that is known explains them; nearest: {table[0]['text']} ({table[0]['left']:.0%} left). "
            "Is it this policy?",
            (), right, tuple(table),
        )  # fmt: skip
    best = good[0]
    rivals = [t for t in good[1:] if t["kind"] != best["kind"] and best["left"] > APART * t["left"]]
    errors = (best, *{t["kind"]: t for t in rivals[::-1]}.values())
    verdict = "ambiguous" if rivals else "broken"
    return Found(
        verdict, _broken(" or ".join(e["text"] for e in errors), right, best["left"]), errors, right, tuple(table)
    )


def _broken(text: str, right: float, left: float | None = None) -> str:
    after = "" if left is None else f", {left:.1%} so"
    return f"The policy's contract is broken: {text}. Run rightly, {right:.0%} of the targets' spread is left{after}."


def _left(contract: Contract, steps: Steps, mistake: Mistake) -> float:
    """Rms of what is left over the rms of the targets about their means; the median over joints of neither."""
    sent = np.concatenate([r.command[max(t.history for t in contract.terms) :] for r in steps.runs])
    spread = float(np.sqrt(np.mean((sent - sent.mean(axis=0)) ** 2)))
    error = residual(contract, steps, mistake)
    return float(np.sqrt(np.mean(error**2))) / max(spread, 1e-9)


def _at_policy_rate(contract: Contract, steps: Steps) -> Steps:
    if steps.period > 0.75 * contract.period:
        return steps
    found = [at_changes(steps, late) for late in (0, 1)]
    return min(found, key=lambda s: _left(contract, s, Mistake()))


def _gains(contract: Contract, steps: Steps) -> dict[str, Any] | None:
    """Servo gains by least squares of the measured torque on kp (target - q) - kd dq; None where they are right."""
    runs = [r for r in steps.runs if r.torque is not None and np.isfinite(r.torque).all()]
    if not runs:
        return None
    order = [steps.joints.index(j) for j in contract.joints]
    ratios: list[tuple[float, float]] = []
    for i, j in enumerate(order):
        x = np.concatenate([np.stack([r.command[:-1, j] - r.pos[1:, j], -r.vel[1:, j]], axis=1) for r in runs])
        y = np.concatenate([r.torque[1:, j] for r in runs if r.torque is not None])
        gains, share = _fit(x, y)
        if share > SURE:
            ratios.append((gains[0] / contract.kp[i], gains[1] / max(contract.kd[i], 1e-9)))
    if len(ratios) < 0.5 * len(order):
        return None
    kp, kd = np.median(np.array(ratios), axis=0)
    off = [f"{name} is {ratio:.3g} of what it should be" for name, ratio in (("kp", kp), ("kd", kd))
           if abs(ratio - 1) > GAIN_OFF * (1 if name == "kp" else 2)]  # fmt: skip
    return {"kind": "gains", "text": " and ".join(off), "left": 0.0} if off else None


def _fit(x: F64, y: F64) -> tuple[F64, float]:
    found, *_ = np.linalg.lstsq(x, y, rcond=None)
    total = float(np.sum((y - y.mean()) ** 2))
    rest = y - x @ found
    return np.asarray(found, dtype=np.float64), 1 - float(np.sum((rest - rest.mean()) ** 2)) / max(total, 1e-12)


__all__ = ["Found", "Hypothesis", "check"]
