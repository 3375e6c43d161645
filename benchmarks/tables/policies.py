"""Tables of policies: the bases that ship and test-time training."""

from __future__ import annotations

from benchmarks import base_policy, ttt
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


def tuned() -> list[str]:
    """The thirteen tests before and after fine-tuning on each."""
    return ttt.table(stored("ttt")["rows"])


def reconstructed() -> list[str]:
    """The same of the last base that was fine-tuned on reconstructions, if a newer one is in the table above."""
    rows = stored("ttt")["rows"]
    bases = list(dict.fromkeys(r["base"] for r in rows if r["source"] != "exact"))
    return ttt.table(rows, bases[-1])


def well_crossed(method: str) -> str:
    """On how many tests a policy succeeds in 97 % of the trials, with every seed: fine-tuned on the exact terrain, or
    the base."""
    rows = stored("ttt")["rows"]
    of = [r for r in rows if (r["base"], r["method"], r["source"]) == (rows[-1]["base"], method, "exact")]
    tests = {r["test"] for r in of}
    missed = {r["test"] for r in of if r["won"] < 0.97 * r["trials"]}
    return f"{len(tests - missed)} of {len(tests)}"
