"""Whether a fine-tuned policy is better than its base, by trials; which of them is delivered, and what to try."""

from collections import Counter
from dataclasses import dataclass
from statistics import median
from typing import Any

from trainer.config import Evaluation

CHANCE = 0.05
"""A policy is better if fewer pairs of equally good policies than this share would differ so much."""

AT_ONCE = 1.0
"""Seconds: a robot that fails sooner has not begun to walk (at 0.8 m/s it is still on the start platform)."""


@dataclass(frozen=True)
class Verdict:
    """Base and fine-tuned policy side by side."""

    better: bool
    p: float
    """Chance that equally good policies differ so much in favour of the second (Fisher's exact test, one-sided)."""
    text: str
    failures: tuple[str, ...]
    """Where the better of the two fails most, a line a terrain."""
    advice: tuple[str, ...]

    def lines(self) -> list[str]:
        """For the terminal."""
        return [
            f"delivered      {self.text}",
            *(f"fails          {line}" for line in self.failures),
            *(f"try            {line}" for line in self.advice),
        ]

    def as_dict(self) -> dict[str, Any]:
        return {"delivered": "tuned" if self.better else "base", **vars(self)}


def judge(before: Evaluation, after: Evaluation) -> Verdict:
    """The verdict on trials of a base and of what was made of it; on several terrains their successes are added."""
    from scipy.stats import fisher_exact  # takes most of a second to import

    (won_a, of_a), (won_b, of_b) = (_total(e) for e in (before, after))
    p = float(fisher_exact([[won_b, of_b - won_b], [won_a, of_a - won_a]], alternative="greater").pvalue)
    better = p < CHANCE
    rates = f"{won_b / of_b:.1%} after, {won_a / of_a:.1%} before"
    if better:
        text = f"the fine-tuned policy: {rates} (p {p:.2g})"
    else:
        text = f"the base, unchanged: training did not beat it beyond chance ({rates}; p {p:.2g}, wanted < {CHANCE:g})"
    best = after if better else before
    return Verdict(better, p, text, tuple(_failures(best)), tuple(_advice(before, after, better)))


def _total(evaluation: Evaluation) -> tuple[int, int]:
    own = [r for r in evaluation.results if r.geometry == "trained"]
    return sum(r.successes for r in own), sum(r.trials for r in own)


def _failures(evaluation: Evaluation) -> list[str]:
    lines = []
    for result in evaluation.results:
        if result.bins:
            low, high, worst = max(result.bins, key=lambda b: sum(b[2].values()))
            causes = ", ".join(f"{k} {v}" for k, v in worst.items())
            count = sum(worst.values())
            lines.append(f"{result.terrain}: {count} of {result.trials} trials at {low:.2f} to {high:.2f} m ({causes})")
    return lines


def _advice(before: Evaluation, after: Evaluation, better: bool) -> list[str]:
    if better or _total(before)[0] == _total(before)[1]:
        return []
    causes: Counter[str] = Counter()
    for result in after.results:
        causes.update(result.reasons)
    waits, falls = causes["timeout"] + causes["stuck"], causes["ground"] + causes["tilt"]
    advice = ["more time: --minutes, with --resume to go on from where this run ended"]
    ends = [f["seconds"] for r in after.results for f in r.failures]
    if ends and median(ends) < AT_ONCE:
        advice.insert(0, f"half of the failures come within {median(ends):.1f} s: does the robot stand on the start? "
                         "(`realsim view`, `realsim robot check`)")  # fmt: skip
    elif _total(after)[0] == 0:
        far = max(r.covered for r in after.results)
        advice.insert(
            0, f"no trial reached the goal, {far:.0%} of the way were covered: is there a way? (`realsim view`)"
        )
    if waits > falls:
        advice.append("the policy waits: --first-success help begins on wider tops and makes waiting cost more")
    elif falls:
        advice.append("look at a failing trial with `realsim play`; is the scan right there? (`realsim view`)")
    return advice
