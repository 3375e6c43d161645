"""Tables of policies: the bases that ship and test-time training."""

from __future__ import annotations

from benchmarks.tables.stored import stored
from benchmarks.training import base_policy, pushes, ttt

SHIPS = "883606ff"
"""The base of G1 that ships (see `ttt.KEY`). Trainings that began with another one are in results/ttt.json alone."""


def families(difficulty: str, setting: str = "mild") -> str:
    """Mean and worst share over the eight families; settings are `base_policy.SETTINGS`."""
    groups = base_policy.grouped(stored("base_policy")["rows"], setting)
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
    """The thirteen tests: fine-tuned on each or on all, and trained from scratch."""
    rows = [r for r in _trained() if r["source"] == "exact" and r["strategy"] == "full"]
    # Without a base it makes no difference which one shipped when they were trained.
    rows = [r for r in rows if r["base"] == SHIPS or (r["method"], r["base"]) == ("scratch", "64a03f3f")]
    return ttt.table(rows, dict.fromkeys((r["base"] for r in rows), ""))


def reconstructed() -> list[str]:
    """The base that ships, fine-tuned on the exact terrain and on what was reconstructed of it."""
    return ttt.table([r for r in _of_one_test() if r["strategy"] == "full"], {SHIPS: ""})


def all_reconstructed() -> list[str]:
    """The same, one policy for all of them at once."""
    return ttt.table([r for r in _trained() if r["base"] == SHIPS and r["method"] == "ttt13f"], {SHIPS: ""})


def by_worlds() -> list[str]:
    """One policy for all tests after eight minutes, by how many worlds practise at once; every run."""
    return _means("worlds", stored("ttt_worlds")["rows"])


def by_pushes() -> list[str]:
    """One policy for all tests after fourteen minutes, by the pushes of its training; every run of pairs."""
    rows = [r for r in stored("ttt")["rows"] if r["method"] == "ttt13f" and r["source"] == "exact"]
    paired = {(r["minutes"], r["seed"]) for r in rows if r["pushes"] != ttt.FEW_PUSHES}
    return _means("pushes", [r for r in rows if (r["minutes"], r["seed"]) in paired])


def _means(what: str, rows: list[ttt.Row]) -> list[str]:
    """A line a run: means over the tests, and the two narrowest footholds by themselves."""
    head = (what, "seed", "iterations", "mean", "all randomisation", "self-collision", "`stake2`", "`narrow3`")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for value, seed in sorted({(r[what], r["seed"]) for r in rows}):
        of = [r for r in rows if (r[what], r["seed"]) == (value, seed)]
        means = [100 * sum(r[k] for r in of) / sum(r["trials"] for r in of) for k in ("won", "won_robust", "won_self")]
        hard = [100 * r["won"] / r["trials"] for test in ("stake2", "narrow3") for r in of if r["test"] == test]
        shares = " | ".join(f"{share:.1f} %" for share in (*means, *hard))
        lines.append(f"| {value} | {seed} | {of[0]['iterations']} | {shares} |")
    return lines


def strategies() -> list[str]:
    """The same, fine-tuned in part, on the tests on which that was tried."""
    rows = [r for r in _of_one_test() if r["source"] == "exact"]
    tried = {r["test"] for r in rows if r["strategy"] != "full"}
    return ttt.table([r for r in rows if r["test"] in tried], {SHIPS: ""})


def _of_one_test() -> list[ttt.Row]:
    """Rows of the base that ships, fine-tuned on one test."""
    return [r for r in _trained() if r["base"] == SHIPS and r["method"] == "ttt1"]


def _trained() -> list[ttt.Row]:
    """Those with the pushes that G1 had in fine-tuning before; `by_pushes` has what is beside them."""
    return [r for r in stored("ttt")["rows"] if r["pushes"] in (None, ttt.FEW_PUSHES)]


def _tuned_now() -> list[ttt.Row]:
    """The base that ships, fine-tuned for five minutes on the exact terrain, all weights."""
    return [r for r in _of_one_test() if (r["source"], r["strategy"], r["minutes"]) == ("exact", "full", 5.0)]


def kept() -> list[str]:
    """What full randomisation with pushes leaves of the successes, beside what is wanted."""
    lines = ["| test | little randomisation | all of it, and pushes | kept | below 85 % by |", "|---" * 5 + "|"]
    for r in _tuned_now():
        share = 100 * r["won_robust"] / r["won"]
        shares = [f"{100 * r[k] / r['trials']:.1f} %" for k in ("won", "won_robust")]
        below = f"{85 - share:.1f} points" if share < 85 else ""
        lines.append(f"| {' | '.join([r['test'], *shares, f'{share:.1f} %', below])} |")
    return lines


def well_crossed() -> str:
    """On how many tests 97 % of the trials succeed: with every seed; and before, in the trials on the way."""
    rows = _tuned_now()
    tests = {r["test"] for r in rows}
    missed = {r["test"] for r in rows if r["won"] < 0.97 * r["trials"]}
    before = {r["test"] for r in rows if dict(r["evaluations"])[0] < 0.97}
    return f"{len(tests - missed)} of {len(tests)}; before: {len(tests - before)} of {len(tests)}"
