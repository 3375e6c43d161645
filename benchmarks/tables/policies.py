"""Tables of policies: the bases that ship and test-time training."""

from pathlib import Path
from statistics import mean

from benchmarks.tables.stored import stored
from benchmarks.training import base_policy, ttt

TRAINING = Path(__file__).resolve().parents[2] / "training"
TUNED_FROM = "883606ff"
"""The base of G1 (see `ttt.KEY`) that five minutes were tuned from: after 5,780 iterations."""


def families(difficulty: str, setting: str = "mild") -> str:
    """Mean and worst share over the eight families; settings are `base_policy.SETTINGS`."""
    groups = base_policy.grouped(stored("base_policy")["rows"], setting)
    shares = [100 * won / of for name, (won, of) in groups.items() if name.endswith(f":{difficulty}")]
    return f"{sum(shares) / len(shares):.0f} and {min(shares):.0f} %"


def beside_the_paper() -> list[str]:
    """Where the training of the base differs most from the paper's."""
    last = (TRAINING / "g1" / "curve.csv").read_text().splitlines()[-1].split(",")
    rows = [
        ("pre-training iterations", "100,000", f"{int(last[0]) + 1:,}"),
        ("segmentation of the scan", "a learned 3-D model", "geometry: planes, level faces, what is connected"),
        ("speed that is commanded in training", "constant", "slower before the goal"),
        ("real robot", "yes", "none"),
    ]
    return ["| | TTT-Parkour | here |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)]


def tests() -> list[str]:
    """The thirteen tests: the base, and fine-tuned for five minutes on the exact terrain or on its reconstruction."""
    columns = ("base, %", "tuned, %", "worst seed, %", "tuned, pushed, %", "tuned on the reconstruction, %")
    lines = [f"| test | {' | '.join(columns)} |", "|---" + "|---:" * len(columns) + "|"]
    exact, rebuilt = tuned_rows("exact"), tuned_rows("rgbd")
    for test in dict.fromkeys(r["test"] for r in exact):
        mine = [r for r in exact if r["test"] == test]
        cells = [
            100 * mean(dict(r["evaluations"])[0] for r in mine),
            _percent(mine, "won"),
            min(_percent([r], "won") for r in mine),
            _percent(mine, "won_robust"),
        ]
        other = [r for r in rebuilt if r["test"] == test]
        cells += [_percent(other, "won")] if other else []
        lines.append(f"| {test} | {' | '.join(f'{c:.1f}' for c in cells)} |" + (" |" if not other else ""))
    return lines


def all_at_once() -> list[str]:
    """One policy for all thirteen tests after fourteen minutes, a line a run."""
    rows = [r for r in stored("ttt")["rows"] if r["method"] == "ttt13f" and r["minutes"] == 14.0]
    names = {(r["source"], r["pushes"]) for r in rows}
    lines: list[str] = []
    for source, pushed_by in sorted(names):
        mine = [r for r in rows if (r["source"], r["pushes"]) == (source, pushed_by)]
        lines += [*(means("seed", mine)[:2] if not lines else []), *means("seed", mine)[2:]]
    return lines


def in_a_minute() -> list[str]:
    """The last base that was measured so, fine-tuned for one minute of a GPU that nothing else used; every run."""
    head = ("test", "base, %", "tuned, %", "tuned, pushed, %", "self-collision, %", "iterations", "97 % at")
    lines = [f"| {' | '.join(head)} |", "|---" + "|---:" * (len(head) - 1) + "|"]
    for r in minute_rows():
        shares = [100 * dict(r["evaluations"])[0], *(_percent([r], key) for key in ("won", "won_robust", "won_self"))]
        reached = "never" if r["to_target"] is None else r["to_target"]
        cells = " | ".join(f"{s:.1f}" for s in shares)
        name = r["test"] if r["source"] == "exact" else f"{r['test']}, reconstructed"
        lines.append(f"| {name} | {cells} | {r['iterations']} | {reached} |")
    return lines


def tuned_captures() -> list[str]:
    """From frames of others to a policy: shares won on the true course; every run."""
    lines = [
        "| capture | scene | minutes | iterations | trials | base, % | tuned, % |",
        "|---|---|---:|---:|---|---:|---:|",
    ]
    trial = {"mild": "little randomisation", "full": "all of it, and pushes"}
    for r in stored("tuned_captures")["rows"]:
        shares = " | ".join(f"{_percent([r], key):.1f}" for key in ("won_base", "won_tuned"))
        run = f"{r['scene']} | {r['minutes']:g} | {r['iterations']} | {trial[r['setting']]}"
        lines.append(f"| {r['capture']} | {run} | {shares} |")
    return lines


def means(what: str, rows: list[ttt.Row]) -> list[str]:
    """A line a run: means over the tests, and the two narrowest footholds by themselves."""
    head = ("terrain", "pushes in training", what, "iterations", "mean, %", "pushed, %", "`stake2`, %", "`narrow3`, %")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for value, seed in sorted({(r[what], r["seed"]) for r in rows}):
        of = [r for r in rows if (r[what], r["seed"]) == (value, seed)]
        hard = [_percent([r], "won") for test in ("stake2", "narrow3") for r in of if r["test"] == test]
        shares = " | ".join(f"{share:.1f}" for share in (_percent(of, "won"), _percent(of, "won_robust"), *hard))
        begun = f"{of[0]['source']} | {of[0]['pushes']} | {value}"
        lines.append(f"| {begun} | {of[0]['iterations']} | {shares} |")
    return lines


def _percent(rows: list[ttt.Row], key: str) -> float:
    return 100 * sum(r[key] for r in rows) / sum(r["trials"] for r in rows)


def strategies() -> list[str]:
    """Which part of the policy is fine-tuned for five minutes, on the tests on which each was tried: means of runs."""
    rows = [
        r for r in stored("ttt")["rows"]
        if (r["base"], r["method"], r["source"], r["minutes"]) == (TUNED_FROM, "ttt1", "exact", 5.0)
    ]  # fmt: skip
    tested = list(dict.fromkeys(r["test"] for r in rows if r["strategy"] != "full"))
    lines = [f"| strategy | {' | '.join(f'{t}, %' for t in tested)} |", "|---" + "|---:" * len(tested) + "|"]
    for strategy in sorted({r["strategy"] for r in rows}):
        each = [[r for r in rows if (r["strategy"], r["test"]) == (strategy, test)] for test in tested]
        cells = " | ".join(f"{_percent(mine, 'won'):.1f}" if mine else "" for mine in each)
        lines.append(f"| {strategy} | {cells} |")
    return lines


def tuned_rows(source: str = "exact") -> list[ttt.Row]:
    """The base that ships, fine-tuned for five minutes on one test, all weights."""
    wanted = (TUNED_FROM, "ttt1", source, "full", 5.0)
    keys = ("base", "method", "source", "strategy", "minutes")
    return [r for r in stored("ttt")["rows"] if tuple(r[k] for k in keys) == wanted]


def minute_rows() -> list[ttt.Row]:
    """Fine-tuned for one minute on one test, from the last base that was measured so."""
    rows = [r for r in stored("ttt")["rows"] if (r["method"], r["minutes"]) == ("ttt1", 1.0)]
    return [r for r in rows if r["base"] == rows[-1]["base"]]


def minute_base() -> str:
    """Which base that is."""
    ships = base_policy.bases(stored("base_policy")["rows"])[-1]
    return "the base that ships" if minute_rows()[-1]["base"] == ships else "the base before"


def well_crossed() -> str:
    """On how many tests 97 % of the trials succeed after a minute, and before."""
    rows = [r for r in minute_rows() if r["source"] == "exact"]
    reached = sum(r["won"] >= 0.97 * r["trials"] for r in rows)
    before = sum(dict(r["evaluations"])[0] >= 0.97 for r in rows)
    return f"{reached} of {len(rows)}; before: {before} of {len(rows)}"
