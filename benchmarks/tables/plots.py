"""Pictures of stored rows, as SVG files that need no style sheet: those of the report, and two of the docs."""

import re

from benchmarks.tables.diagnosis import real_figures
from benchmarks.tables.fresh import measures, rows_of
from benchmarks.tables.policies import tuned_rows
from benchmarks.tables.stored import stored
from realsim.report.svg import Axes, Bar, bars
from trainer.evaluate import wilson

COLORS = {
    "c0": "#2563c9", "c1": "#d9622b", "ink": "#16191f", "soft": "#565d69", "faint": "#9aa1ad", "line": "#e3e6eb",
}  # fmt: skip
"""Those of the reports' style sheet in its light theme: a picture in Markdown has none."""
ANSWERS = {
    "exact, one cause": "one cause: `identified`, with exactly that cause",
    "exact, two causes": "two causes: `identified`, with exactly these",
    "first, one cause": "one cause, named first",
    "both of two named": "two causes, both",
    "false alarm": "nothing wrong, something named",
    "outside, reported": "outside the library, reported as such",
    "interval holds": "90 % intervals hold the truth",
}
REAL = {
    "exact, one error": "single_exact",
    "first, one error": "single_first_right",
    "both of two errors": "double_both_right",
    "surely wrong": "confident_and_wrong",
}


def pictures() -> dict[str, str]:
    """File name -> SVG."""
    answers, real = measures(rows_of()), real_figures()
    return {
        "diagnosis.svg": _shares({name: answers[title] for name, title in ANSWERS.items()}),
        "real_logs.svg": _shares({name: real[key] for name, key in REAL.items()}),
        "fine_tuning.svg": _before_and_after(),
    }


def pictures_of_docs() -> dict[str, str]:
    """File name in docs/images -> SVG."""
    return {"close_the_gap.svg": _closed(), "trainer_cpu.svg": _learning()}


def _closed() -> str:
    """Success and speed on flat ground of a robot that its model does not describe."""
    arms, items = {"before": "before", "random": "randomisation", "patch": "diagnosed"}, []
    for r in stored("close_the_gap")["rows"]:
        for arm, title in arms.items() if r["course"] == "flat" else ():
            rate, (low, high) = r[arm]["rate"], r[arm]["interval"]
            fill = "var(--c1)" if arm == "before" else "var(--faint)" if arm == "random" else "var(--c0)"
            name, speed = f"{r['robot']}, {title}", f"{r[arm]['speed']:.2f} m/s"
            items.append(Bar(name, 100 * rate, 100 * low, 100 * high, fill, speed))
    return _alone(bars(items, x_label="% that arrive, 95 % intervals, and speed", x=(0, 140)))


def _learning() -> str:
    """Reward and success of the quadruped over its iterations on one core."""
    row = stored("trainer_cpu")["rows"][0]
    axes = Axes((0, row["iterations"]), (-4, 108), width=640, height=280, x_label="iterations", y_label="%")
    # Worlds begin anew at every checkpoint: episodes that end soon after are short. A step's reward is comparable.
    steps = zip(row["curve"]["return"], row["curve"]["length"], strict=True)
    rewards = [(i, r / n) for i, (r, n) in enumerate(steps) if n]
    most = max(r for _, r in rewards)
    axes.polyline([(i, 100 * r / most) for i, r in rewards], "var(--c0)")
    axes.polyline([(i, 100 * rate) for i, rate in row["evaluations"]], "var(--c1)")
    axes.text(5, 102, "reward a step of an episode, of the most", fill="var(--c0)", anchor="start")
    axes.text(row["iterations"] - 5, 102, "trials of the policy that arrive", fill="var(--c1)", anchor="end")
    return _alone(axes.svg("reward and success over training"))


def _shares(counts: dict[str, tuple[int, int]]) -> str:
    items = []
    for name, (hits, of) in counts.items():
        low, high = wilson(hits, of)
        items.append(Bar(name, 100 * hits / of, 100 * low, 100 * high, text=f"{hits} of {of}"))
    return _alone(bars(items, x_label="% of the cases, with 95 % intervals", x=(0, 130)))


def _before_and_after() -> str:
    rows, items = tuned_rows(), []
    for test in dict.fromkeys(r["test"] for r in rows):
        mine = [r for r in rows if r["test"] == test]
        before = [100 * dict(r["evaluations"])[0] for r in mine]
        after = [100 * r["won"] / r["trials"] for r in mine]
        items.append(Bar(f"{test}, base", sum(before) / len(before), fill="var(--c1)"))
        items.append(Bar(f"{test}, tuned", sum(after) / len(after), min(after), max(after)))
    return _alone(bars(items, x_label="% of the trials that arrive; whiskers: least and most of the seeds", x=(0, 130)))


def _alone(svg: str) -> str:
    """An inline picture as a file: its colours written out, on white."""
    svg = re.sub(r"var\(--(\w+)\)", lambda m: COLORS[m[1]], svg)
    style = "<style>text{font:12px sans-serif;fill:#16191f}.grid{stroke:#e3e6eb;fill:none}</style>"
    opened = re.sub(r"^<svg", '<svg xmlns="http://www.w3.org/2000/svg" style="background:#fff"', svg, count=1)
    end = opened.index(">") + 1
    return f"{opened[:end]}{style}{opened[end:]}\n"
