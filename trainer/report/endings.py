"""How episodes end while training, and where along the course trials of `realsim evaluate` failed."""

import math
from collections.abc import Iterable, Sequence

from realsim.report import page, svg
from trainer.report.curves import WIDTH, format_value
from trainer.report.evaluations import Evaluated
from trainer.report.figures import Figure, Shown, absent, families, multiples
from trainer.report.history import LAST, Run

CAUSES = ("ground", "tilt", "collapsed", "stuck", "timeout", "diverged")
"""In the order of their colours; another cause comes after them."""
SUCCESS = "success"


def endings(runs: Sequence[Run]) -> Figure:
    """Shares of the episodes that ended, by cause."""
    found = _ordered(n.removeprefix("env/end/") for run in runs for n in run.columns if n.startswith("env/end/"))
    # A cause that never ends an episode needs no plot.
    every = {c: [run.column(f"env/end/{c}") for run in runs] for c in found}
    found = [c for c in found if any(values is not None and (values > 0).any() for values in every[c])]
    names = ("env/success", *(f"env/end/{c}" for c in found))
    return Figure("Ended by", names, (SUCCESS, *found), "share", tuple(_color(c) for c in (SUCCESS, *found)))


def by_family(shown: Shown) -> str:
    """Bars cut by how the last episodes of a family ended; nothing where families are not distinguished."""
    found = [
        (family, run.name, shares)
        for family in families(shown.runs)
        for run in shown.runs
        if (shares := _family_shares(run, family))
    ]
    if not found:
        return ""
    causes = [SUCCESS, *_ordered(c for *_, shares in found for c in shares if c != SUCCESS)]
    groups = {"By family": [(family, shares) for family, _, shares in found]}
    if not shown.one:
        groups = {f: [(name, shares) for g, name, shares in found if g == f] for f, *_ in found}
    plots = [_bars(title, rows, causes) for title, rows in groups.items()]
    return absent(f"By terrain family, mean over the last {LAST} iterations:") + multiples(plots) + _legend(causes)


def _family_shares(run: Run, family: str) -> dict[str, float]:
    prefix = f"env/family/{family}/"
    ends = {n.removeprefix(f"{prefix}end/"): n for n in run.columns if n.startswith(f"{prefix}end/")}
    shares = {cause: run.mean(name) for cause, name in {SUCCESS: f"{prefix}success", **ends}.items()}
    return {cause: share for cause, share in shares.items() if math.isfinite(share) and share > 0} if ends else {}


def _bars(title: str, rows: Sequence[tuple[str, dict[str, float]]], causes: Sequence[str]) -> str:
    n, brief = len(rows), [name if len(name) <= 20 else f"{name[:19]}…" for name, _ in rows]
    axes = svg.Axes((0, 1), (-0.5, n - 0.5), width=WIDTH, height=22 * n + 26, right=22, bottom=24, top=2, grid=False,
                    x_ticks=[(k / 4, f"{25 * k} %") for k in range(5)],
                    y_ticks=[(n - 1 - i, name) for i, name in enumerate(brief)])  # fmt: skip
    for i, (name, shares) in enumerate(rows):
        at, y = 0.0, n - 1 - i
        for cause in causes:
            share = shares.get(cause, 0.0)
            if share > 0:
                title_ = f"{name}: {cause} {format_value(share, 'share')}"
                _rectangle(axes, (at, at + share), (y - 0.38, y + 0.38), cause, title_)
                at += share
    return f"<figure><h4>{page.esc(title)}</h4>{axes.svg(f'how episodes end, {title}')}</figure>"


# ---------------------------------------------------------------- trials


def course_card(shown: Shown) -> str:
    """Where trials failed, terrain by terrain; the same axes for all evaluations of a terrain."""
    evaluated = [(e.title if shown.one else f"{run.name}, {e.title}", e) for run in shown.runs for e in run.evaluations]
    title, note = "Failures along the course", "Share of all trials that failed there, by distance from the start."
    if not evaluated:
        how = "No trials: `realsim evaluate SCENE --policy RUN/policy.pt --out RUN/evaluation_SCENE.json` runs some."
        return page.card(title, f'<p class="note">{page.esc(how)}</p>', wide=True)
    along = []
    for terrain in dict.fromkeys(e.terrain for _, e in evaluated):
        along += _along([(name, e) for name, e in evaluated if e.terrain == terrain])
    causes = _ordered(c for _, e in evaluated for c in e.result.reasons)
    return page.card(title, multiples(along) + _legend(causes), note, wide=True)


def evaluation_table(shown: Shown) -> str:
    """Every evaluation with its interval; nothing without any."""
    head = ["run", "evaluation", "terrain", "success", "95 % interval", "trials", "covered", "seconds", "failed by"]
    rows = []
    for run in shown.runs:
        for e in run.evaluations:
            r = e.result
            low, high = (format_value(v, "share") for v in r.interval)
            causes = ", ".join(f"{cause} {count}" for cause, count in r.reasons.items()) or "–"
            causes += f"; {r.overflowed} contacts dropped" if r.overflowed else ""
            seconds = "–" if r.seconds is None else f"{r.seconds:.1f}"
            rate, covered = (format_value(v, "share") for v in (r.rate, r.covered))
            figures = [rate, f"{low} to {high}", str(r.trials), covered, seconds, causes]
            rows.append([run.name, e.title, e.terrain, *figures])
    drop = 1 if shown.one else 0
    table = page.table(head[drop:], [r[drop:] for r in rows])
    return page.card("Evaluations", f'<div class="lines">{table}</div>', wide=True) if rows else ""


def _along(group: Sequence[tuple[str, Evaluated]]) -> list[str]:
    each = [(name, e.terrain, e.result, e.result.bins) for name, e in group]
    if not any(bins for *_, bins in each):
        return [f"<h4>{page.esc(f'{on}, {name}: no failure in {r.trials} trials')}</h4>" for name, on, r, _ in each]
    x = (min(0.0, *(w[0] for *_, bins in each for w in bins)), max(w[1] for *_, bins in each for w in bins))
    top = max(sum(w[2].values()) / r.trials for _, _, r, bins in each for w in bins)
    steps = [(v, f"{svg.number(100 * v)} %") for v in svg.ticks(0, 1.1 * top, 4)]
    pictures = []
    for name, on, r, bins in each:
        axes = svg.Axes(svg.padded(x, 0.02), (0, 1.1 * top), width=WIDTH, height=150, y_ticks=steps, x_label="along, m")
        for low, high, counts in bins:
            at = 0.0
            for cause in _ordered(counts):
                share = counts[cause] / r.trials
                text = f"{low:g} to {high:g} m: {cause} {counts[cause]}"
                _rectangle(axes, (low, high), (at, at + share), cause, text)
                at += share
        heading = f"{on}, {name}: {format_value(r.rate, 'share')} of {r.trials} succeed"
        picture = axes.svg(f"failures along {on}, {name}")
        pictures.append(f"<figure><h4>{page.esc(heading)}</h4>{picture}</figure>")
    return pictures


# ---------------------------------------------------------------- colours


def _rectangle(axes: svg.Axes, x: tuple[float, float], y: tuple[float, float], cause: str, title: str) -> None:
    ring = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]
    axes.polyline(ring, "var(--card)", width=0.8, fill=_fill(cause), closed=True, title=title)


def _ordered(causes: Iterable[str]) -> list[str]:
    """Each once, those that are known first and in their order."""
    found = set(causes)
    return [c for c in CAUSES if c in found] + sorted(found - set(CAUSES))


def _color(cause: str) -> int:
    """Success green, each cause its own; those that are not known share the last."""
    if cause == SUCCESS:
        return 2
    return (1, 3, 4, 5, 0, 6)[CAUSES.index(cause)] if cause in CAUSES else 7


def _fill(cause: str) -> str:
    return svg.color(_color(cause))


def _legend(causes: Iterable[str]) -> str:
    return page.legend([(c, _fill(c)) for c in causes])
