"""Tables of policies: the bases that ship and test-time training."""

from __future__ import annotations

from benchmarks import base_policy, pushes, ttt
from benchmarks.tables.stored import stored


def families(difficulty: str) -> str:
    groups = base_policy.grouped(stored("base_policy")["rows"], "mild")
    shares = [100 * won / of for name, (won, of) in groups.items() if name.endswith(f":{difficulty}")]
    return f"{sum(shares) / len(shares):.0f} and {min(shares):.0f} %"


def base() -> list[str]:
    """The base policy on every family, difficulty and test."""
    return base_policy.table(stored("base_policy")["rows"])


def quadruped_base() -> list[str]:
    """The same of the quadruped's."""
    return base_policy.table(stored("base_policy")["rows"], "quadruped")


def pushed() -> list[str]:
    """The base on the thirteen tests, pushed more and more."""
    return pushes.table(stored("pushes")["rows"])


def tuned() -> list[str]:
    """The thirteen tests: the base that ships, fine-tuned on each or on all, and trained from scratch."""
    return ttt.table([r for r in _of_the_base() if r["source"] == "exact" and r["strategy"] == "full"])


def reconstructed() -> list[str]:
    """The same base, fine-tuned on the exact terrain and on what was reconstructed of it."""
    return ttt.table([r for r in _of_the_base() if r["method"] == "ttt1" and r["strategy"] == "full"])


def strategies() -> list[str]:
    """The same base, fine-tuned in part, on the tests on which that was tried."""
    rows = [r for r in _of_the_base() if r["method"] == "ttt1" and r["source"] == "exact"]
    tried = {r["test"] for r in rows if r["strategy"] != "full"}
    return ttt.table([r for r in rows if r["test"] in tried])


def _of_the_base() -> list[ttt.Row]:
    """Rows of the base that was measured last."""
    rows = stored("ttt")["rows"]
    return [r for r in rows if r["base"] == rows[-1]["base"]]


def well_crossed(method: str) -> str:
    """On how many tests a policy succeeds in 97 % of the trials, with every seed: fine-tuned on the exact terrain, all
    weights, or the base."""
    of = [r for r in _of_the_base() if (r["method"], r["source"], r["strategy"]) == (method, "exact", "full")]
    tests = {r["test"] for r in of}
    missed = {r["test"] for r in of if r["won"] < 0.97 * r["trials"]}
    return f"{len(tests - missed)} of {len(tests)}"
