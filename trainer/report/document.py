"""The page of one training run, or of several over each other."""

from collections.abc import Sequence
from importlib.resources import files

from realsim.report import page, svg
from trainer.report import curves, endings, figures, tables
from trainer.report.figures import Shown
from trainer.report.history import LAST, Run

_FIRST_TERMS = 6
"""Reward terms that are shown at once; the rest is folded away."""


def training_page(runs: Sequence[Run], extra: Sequence[str] = ()) -> str:
    """The whole page as text.

    Args:
        runs: at least one.
        extra: further cards (rendered trials), after the evaluations.
    """
    shown = Shown.of(runs)
    notes = [note if shown.one else f"{run.name}: {note}" for run in runs for note in run.notes]
    cards = [
        _overall(shown),
        _families(shown),
        endings.evaluation_table(shown),
        endings.course_card(shown),
        *extra,
        figures.card("How episodes end", [endings.endings(runs)], shown, more=endings.by_family(shown)),
        figures.card("Learning", figures.learning(), shown),
        figures.card("Exploration noise (standard deviation of the actions)", figures.noise(runs), shown),
        _rewards(shown),
        figures.card("Physics", figures.physics(), shown),
        figures.card("Time", figures.clock(runs), shown),
        _rest(shown),
        page.card("Notes", page.bullets(notes), wide=True),
    ]
    top = _facts(shown) if shown.one else page.grid(tables.runs_card(shown), tables.budget_card(shown))
    body = "".join([*_pick(shown), top, page.grid(*filter(None, cards))])
    title = f"Training of {runs[0].name}" if shown.one else f"{len(runs)} training runs"
    css = files("trainer.report").joinpath("page.css").read_text(encoding="utf-8")
    return page.document(title, _subtitle(runs), f"<style>{css}</style>{body}")


def _pick(shown: Shown) -> list[str]:
    """The choice of the axis, which stays in view, with the colours of the runs. No script: the style follows it."""
    known = list(shown.reach)
    boxes = [
        f'<input class="choice" type="radio" name="x" id="x-{axis}" aria-label="over {axis}"'
        f"{' checked' if axis == known[0] else ''}/>"
        for axis in known
    ]
    labels = "".join(f'<label for="x-{axis}">{axis}</label>' for axis in known)
    colors = "" if shown.one else page.legend([(r.name, svg.color(i)) for i, r in enumerate(shown.runs)])
    return [*boxes, f'<nav class="pick">over {labels}{colors}</nav>']


def _subtitle(runs: Sequence[Run]) -> str:
    parts = [*dict.fromkeys(r.robot for r in runs if r.robot)]
    parts += [str(r.folder) for r in runs if len(runs) > 1 or str(r.folder) != r.name]
    if len(runs) == 1 and len(seen := runs[0].on_the_way) > 1:
        (first, before), (last, after) = seen[0, :2], seen[-1, :2]
        parts.insert(0, f"evaluations: success {tables.percent(before)} after {first:.0f} iterations, "
                        f"{tables.percent(after)} after {last:.0f}")  # fmt: skip
    return ", ".join(parts)


def _facts(shown: Shown) -> str:
    run = shown.runs[0]
    iterations, samples, minutes, speed = tables.progress(run)
    found = [
        ("Iterations", iterations, f"{minutes} minutes"),
        ("Samples", samples, f"{speed} per second"),
        ("Success", tables.percent(run.mean("env/success")), f"of the episodes, last {LAST} iterations"),
        ("Covered", tables.percent(run.mean("env/episode/covered")), "of the way"),
        ("Row", svg.number(run.mean("env/terrain/level")), "of the curriculum, mean"),
    ]
    if len(run.on_the_way):
        found.append(
            ("Evaluation", tables.percent(run.on_the_way[-1, 1]), f"after {run.on_the_way[-1, 0]:.0f} iterations")
        )
    return page.facts(found)


def _families(shown: Shown) -> str:
    title = "By terrain family"
    if not figures.families(shown.runs):
        return page.card(title, figures.absent("Not logged: success, way covered and row by family."), wide=True)
    return figures.card(title, figures.by_family(shown.runs), shown)


def _overall(shown: Shown) -> str:
    """Means over all episodes, and the evaluations on the way."""
    found = [curves.evaluated(run, run.name, i) for i, run in enumerate(shown.runs)]
    kept = [c for c in found if c is not None]
    targets = ", ".join(sorted({f"{run.target:.0%}" for run in shown.runs if run.target is not None}))
    title = "Success in evaluations on the way" + (f" (aim: {targets})" if targets else "")
    plots = [curves.plot(title, kept, shown.reach, scale="share")] if kept else []
    without = ", ".join(run.name for run, c in zip(shown.runs, found, strict=True) if c is None)
    more = figures.absent(f"No evaluations on the way: {without}." if without else "")
    means = "" if shown.width == 1 else f"Every point is the mean of {shown.width} iterations. "
    note = means + "While exploring, on the rows that the curriculum has reached."
    return figures.card("Overall", figures.overall(), shown, note, first=plots, more=more)


def _rewards(shown: Shown) -> str:
    terms, zero = figures.rewards(shown.runs)
    note = "Reward per step of each term with its weight, largest first."
    rest = [plot for figure in terms[_FIRST_TERMS:] for plot in figures.draw(figure, shown)]
    more = page.fold(f"{len(rest)} smaller terms", figures.multiples(rest)) if rest else ""
    more += figures.absent(f"Zero throughout: {', '.join(zero)}." if zero else "" if terms else "Not logged.")
    return figures.card("Reward terms", terms[:_FIRST_TERMS], shown, note, more=more)


def _rest(shown: Shown) -> str:
    others = figures.rest(shown.runs)
    plots = figures.multiples([plot for figure in others for plot in figures.draw(figure, shown)])
    return page.card("Other figures", page.fold("what this page has no place for", plots), wide=True) if plots else ""
