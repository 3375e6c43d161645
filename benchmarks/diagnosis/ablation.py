"""What each part of the engine is worth: the same cases with and without it, paired, by McNemar's exact test.

    python benchmarks/diagnosis/ablation.py make --cases 100 --seed 11 --jobs 16
    python benchmarks/diagnosis/ablation.py run --without realsim.gap.inference.causes.proposals:by_window --jobs 16
    --minutes 9 python benchmarks/diagnosis/ablation.py score

`run` diagnoses with the full engine and once without each function given (it proposes nothing then), with another
figure in its place (`--without realsim.gap.figures:TIMES=1.0`), or with other settings
(`--with max_causes=1`). `score` compares case by case: a case is right if the verdict is, and with it the
cause where there is one. Rules that every diagnosis reports beside its own answer (the largest fit of a single cause)
are compared by the first cause. No other engine's answers are taken in.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scipy.stats import binomtest

from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.diagnosis.score import hit, same, top1
from realsim.core.files import to_json, write_text
from tests.truths.diagnosis.cases import Draw, make_labelled, plan, read_labels

FULL = "full"
Answers = dict[str, dict[str, Any]]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("do", choices=["make", "run", "score"])
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", nargs="*", help="only these robots")
    parser.add_argument("--without", nargs="*", default=[], metavar="MODULE:FUNCTION")
    parser.add_argument("--with", nargs="*", default=[], dest="settings", metavar="SETTING=VALUE")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="start no case after this many minutes")
    parser.add_argument("--work", type=Path, default=Path("out/gap_ablation"))
    parser.add_argument("--store", type=Path, help="file for the figures (default: figures.json in --work)")
    args = parser.parse_args()
    if args.do == "make":
        draws = [(i, d) for i, d in enumerate(plan(args.cases, args.seed)) if not args.robots or d.robot in args.robots]
        with ProcessPoolExecutor(args.jobs) as pool:
            for line in pool.map(_make, [(i, d, args.work) for i, d in draws]):
                print(line, flush=True)
        return 0
    labels = read_labels(args.work)
    if args.do == "run":
        variants = [FULL, *(f"without {w}" for w in args.without), *(f"with {s}" for s in args.settings)]
        # Case by case over all variants: what is done after some time can be compared.
        diagnose_all([_job(args.work, v, n) for n in labels for v in variants], args.jobs, args.minutes)
        return 0
    return _score(args, labels)


def _make(todo: tuple[int, Draw, Path]) -> str:
    return make_labelled(*todo)


def _job(work: Path, variant: str, name: str) -> Job:
    what, _, of = variant.partition(" ")
    key, _, value = of.partition("=")
    folder = "".join(c if c.isalnum() or c in "._=" else "-" for c in variant)
    return Job(
        work / "cases" / name,
        work / "out" / folder / name,
        settings={key: json.loads(value)} if what == "with" else {},
        without=of if what == "without" else "",
    )


def right(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Whether the verdict is as it should be, and the causes are where there are some."""
    cls, verdict = label["cls"], answer["verdict"]
    if cls == "none":
        return bool(verdict == "no_gap")
    if cls == "outside":
        return bool(verdict == "unexplained")
    if verdict not in ("identified", "ambiguous", "partly_explained"):
        return False
    if cls == "double":
        return all(any(hit(c, t) for c in answer["causes"]) for t in label["effects"])
    accepted = [label["effects"], *label["equivalents"]]
    return any(same(answer["causes"], a) for a in accepted) or top1(dict(label), dict(answer)) >= 1


def mcnemar(pairs: list[tuple[bool, bool]]) -> dict[str, Any]:
    """Exact two-sided test of (right with, right without): only cases in which they differ count."""
    gained = sum(a and not b for a, b in pairs)
    lost = sum(b and not a for a, b in pairs)
    p = float(binomtest(gained, gained + lost, 0.5).pvalue) if gained + lost else 1.0
    return {
        "with": [sum(a for a, _ in pairs), len(pairs)],
        "without": [sum(b for _, b in pairs), len(pairs)],
        "right_only_with": gained,
        "right_only_without": lost,
        "p": round(p, 4),
    }


def _score(args: argparse.Namespace, labels: Mapping[str, Mapping[str, Any]]) -> int:
    found: dict[str, Answers] = {}
    for folder in sorted((args.work / "out").iterdir()) if (args.work / "out").is_dir() else []:
        answers = {n: a for n in labels if (a := read(Job(args.work / "cases" / n, folder / n))) is not None}
        if answers:
            found[folder.name] = answers
    if FULL not in found:
        print(f"{args.work} has no answers of the full engine: run it first", file=sys.stderr)
        return 2
    engines = {a.get("provenance", {}).get("engine") for answers in found.values() for a in answers.values()}
    if len(engines) > 1:
        print(f"{args.work}: answers of several engines ({', '.join(map(str, engines))}); `run` again", file=sys.stderr)
        return 2
    full = found.pop(FULL)
    rows = {name: _compared(labels, full, answers, right) for name, answers in found.items()}
    rules = sorted({rule for a in full.values() for rule in a.get("baselines") or {}})
    single = {n: a for n, a in full.items() if labels[n]["cls"] == "single"}
    for rule in rules:
        theirs = {n: {"causes": [c]} for n, a in single.items() if (c := (a.get("baselines") or {}).get(rule))}
        rows[f"first cause, against: {rule}"] = _compared(labels, single, theirs, _first)
    print(f"engine {next(iter(engines))}: {len(full)} cases")
    titles = f"{'with':>8} {'without':>8} {'only with':>10} {'only without':>13} {'p':>7} {'other':>6} {'CPU s':>12}"
    print(f"{'':<60} {titles}")
    for name, row in rows.items():
        shares = [f"{row[k][0]}/{row[k][1]}" for k in ("with", "without")]
        only = f"{row['right_only_with']:>10} {row['right_only_without']:>13} {row['p']:>7.4f}"
        only += f" {row['other_answer']:>6} {'/'.join(map(str, row['cpu_seconds'])):>12}"
        print(f"{name:<60} {shares[0]:>8} {shares[1]:>8} {only}")
    store = args.store or args.work / "figures.json"
    write_text(store, to_json({"engine": next(iter(engines)), "seed": args.seed, "compared": rows}))
    return 0


def _first(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    return bool(answer["causes"]) and hit(answer["causes"][0], label["effects"][0])


def _compared(
    labels: Mapping[str, Any], full: Answers, other: Answers, good: Callable[[Any, Any], bool]
) -> dict[str, Any]:
    both = [n for n in full if n in other]
    row = mcnemar([(good(labels[n], full[n]), good(labels[n], other[n])) for n in both])
    row["other_answer"] = sum(_said(full[n]) != _said(other[n]) for n in both)
    row["cpu_seconds"] = [round(sum(a[n].get("cpu_seconds") or 0.0 for n in both)) for a in (full, other)]
    return row


def _said(answer: Mapping[str, Any]) -> Any:
    """Verdict and causes by effect and place."""
    causes = [(c["effect"], tuple(c.get("joints") or c.get("bodies") or ())) for c in answer["causes"]]
    return answer.get("verdict"), causes


if __name__ == "__main__":
    raise SystemExit(main())
