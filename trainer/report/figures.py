"""Which figures of a history belong together, and what they are called. What no group knows is shown too."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from realsim.report import page
from trainer.report import curves
from trainer.report.curves import Curve, Scale
from trainer.report.history import Run

FAMILY = re.compile(r"env/family/([^/]+)/(success|covered|row|episodes|end/.+)")


@dataclass(frozen=True)
class Figure:
    """A plot of one run by figure, or a plot of one figure by run."""

    title: str
    names: tuple[str, ...]
    """Of the history."""
    labels: tuple[str, ...] = ()
    """What they are called, if there are several."""
    scale: Scale = "plain"
    colors: tuple[int, ...] = ()
    """Of the names, where there is one run; in their order if not given."""

    def label(self, name: str) -> str:
        return dict(zip(self.names, self.labels, strict=True)).get(name, name) if self.labels else name


@dataclass(frozen=True)
class Shown:
    """Runs, and what all plots of a page share."""

    runs: tuple[Run, ...]
    width: int
    """Iterations a point."""
    reach: dict[str, float]

    @staticmethod
    def of(runs: Sequence[Run]) -> Shown:
        return Shown(tuple(runs), curves.bin_width(runs), curves.ends(runs))

    @property
    def one(self) -> bool:
        return len(self.runs) == 1


def families(runs: Sequence[Run]) -> list[str]:
    """Terrain families that a run tells apart, in the order of the first history that does."""
    found = [
        m[1] for run in runs for name in run.columns if (m := FAMILY.fullmatch(name)) and run.column(name) is not None
    ]
    return list(dict.fromkeys(found))


def overall() -> list[Figure]:
    return [
        Figure("Success of the episodes that ended", ("env/success",), scale="share"),
        Figure("Share of the way covered", ("env/episode/covered",), scale="share"),
        Figure("Row of the curriculum, mean over the worlds", ("env/terrain/level",)),
        Figure("Reward per step", ("reward",)),
        Figure("Return of an episode", ("return",)),
        Figure("Length of an episode, steps", ("length",)),
        Figure("Seconds of an episode", ("env/episode/seconds",)),
        Figure("Robots that wait", ("env/episode/waiting",), scale="share"),
    ]


def by_family(runs: Sequence[Run]) -> list[Figure]:
    names = families(runs)

    def each(what: str) -> tuple[str, ...]:
        return tuple(f"env/family/{name}/{what}" for name in names)

    return [
        Figure("Success", each("success"), tuple(names), "share"),
        Figure("Way covered", each("covered"), tuple(names), "share"),
        Figure("Row", each("row"), tuple(names)),
    ]


def noise(runs: Sequence[Run]) -> list[Figure]:
    groups = _starting(runs, "std/")
    named = Figure("By joint group", tuple(groups), tuple(g.removeprefix("std/") for g in groups))
    return [named, Figure("Mean of all joints", ("std",)), Figure("Upper bound", ("std_limit",))]


def learning() -> list[Figure]:
    return [
        Figure("KL divergence of an update (log)", ("kl",), scale="log"),
        Figure("Clip fraction", ("clip_fraction",), scale="share"),
        Figure("Explained variance of the value", ("explained_variance",)),
        Figure(
            "Gradient norm before clipping (log)", ("gradient/policy", "gradient/critic"), ("policy", "critic"), "log"
        ),
        Figure("Learning rate (log)", ("learning_rate",), scale="log"),
        Figure("Value loss (log)", ("value_loss",), scale="log"),
        Figure("Policy loss", ("policy_loss",)),
        Figure("Entropy", ("entropy",)),
    ]


def physics() -> list[Figure]:
    return [
        Figure(
            "Policy steps of a world at the solver's limit, per iteration", ("env/physics/solver_limited an iteration",)
        ),
        Figure("Contacts dropped per iteration", ("env/physics/overflowed an iteration",)),
        Figure("Worlds that diverged per iteration", ("env/physics/diverged",)),
    ]


def clock(runs: Sequence[Run]) -> list[Figure]:
    parts = sorted({name for run in runs for name in run.columns if name.endswith("_s") and "/" not in name})
    return [
        Figure("Seconds of an iteration", tuple(parts), tuple(name.removesuffix("_s") for name in parts)),
        Figure("Samples per second", ("samples a second",)),
    ]


def rewards(runs: Sequence[Run]) -> tuple[list[Figure], list[str]]:
    """Terms, those with the most to say in the last iterations first; and those that are zero throughout."""
    names = _starting(runs, "env/reward/")
    size = {name: float(np.nanmax([abs(r.mean(name)) for r in runs] or [0.0])) for name in names}
    ever = {n for n in names for r in runs if (c := r.column(n)) is not None and np.nan_to_num(c).any()}
    live = sorted(ever, key=lambda n: (-np.nan_to_num(size[n]), n))
    zero = [_term(n) for n in names if n not in ever]
    return [Figure(_term(n), (n,)) for n in live], zero


def rest(runs: Sequence[Run]) -> list[Figure]:
    """What no group above knows, nor `trainer.report.endings`."""
    groups = [*overall(), *by_family(runs), *noise(runs), *learning(), *physics(), *clock(runs)]
    known = {name for figure in groups for name in figure.names} | {"samples", "episodes"}
    known |= {name.removesuffix(" an iteration") for name in known}
    every = dict.fromkeys(name for run in runs for name in run.columns if run.column(name) is not None)
    others = [n for n in every if n not in known and not FAMILY.fullmatch(n)]
    return [Figure(n, (n,)) for n in others if not n.startswith(("env/end/", "env/reward/"))]


def draw(figure: Figure, shown: Shown) -> list[str]:
    """One run: all names in one plot. Several: a plot a name, all runs in it. Nothing if no run has it."""
    if shown.one:
        run = shown.runs[0]
        colors = figure.colors or range(len(figure.names))
        named = zip(figure.names, colors, strict=True)
        found = [curves.curve(run, name, figure.label(name), color, shown.width) for name, color in named]
        return _plot(figure, figure.title, found, shown, legend=len(figure.names) > 1)
    plots = []
    for name in figure.names:
        found = [curves.curve(run, name, run.name, i, shown.width) for i, run in enumerate(shown.runs)]
        title = figure.title if len(figure.names) == 1 else f"{figure.title}: {figure.label(name)}"
        plots += _plot(figure, title, found, shown, legend=False)
    return plots


def _plot(figure: Figure, title: str, found: Sequence[Curve | None], shown: Shown, *, legend: bool) -> list[str]:
    kept = [c for c in found if c is not None]
    if not kept:
        return []
    return [curves.plot(title, kept, shown.reach, scale=figure.scale, legend=legend)]


def card(
    title: str, figures: Sequence[Figure], shown: Shown, note: str = "", *, first: Sequence[str] = (), more: str = ""
) -> str:
    """Figures side by side, after the plots `first`; figures that not every run has logged are listed below."""
    plots = [*first, *(plot for figure in figures for plot in draw(figure, shown))]
    body = multiples(plots) + more
    return page.card(title, body + absent(missing(figures, shown)), note, wide=True)


def absent(text: str) -> str:
    """A line on what is not there; nothing of nothing."""
    return f'<p class="note absent">{page.esc(text)}</p>' if text else ""


def multiples(plots: Sequence[str]) -> str:
    """Plots side by side where there is room."""
    return f'<div class="multiples">{"".join(plots)}</div>' if plots else ""


def missing(figures: Sequence[Figure], shown: Shown) -> str:
    """Which figures are not drawn, or not for all runs."""
    none, some = [], []
    for figure in figures:
        without = [r.name for r in shown.runs if not any(r.column(n) is not None for n in figure.names)]
        if len(without) == len(shown.runs):
            none.append(figure.title)
        elif without:
            some.append(f"{figure.title} ({', '.join(without)})")
    parts = [
        f"Not logged: {'; '.join(none)}." if none else "",
        f"Not logged by all: {'; '.join(some)}." if some else "",
    ]
    return " ".join(filter(None, parts))


def _term(name: str) -> str:
    return name.removeprefix("env/reward/").replace("_", " ")


def _starting(runs: Sequence[Run], prefix: str) -> list[str]:
    names = [n for run in runs for n in run.columns if n.startswith(prefix) and run.column(n) is not None]
    return list(dict.fromkeys(names))
