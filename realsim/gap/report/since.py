"""The card of what changed since an earlier log."""

from collections.abc import Iterable, Mapping
from typing import Any

from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.answer.verdict import RIGHT, times
from realsim.gap.effects.lookup import places_of
from realsim.gap.report.words import title_of
from realsim.report import page, svg

_NOTE = (
    "Both logs are fitted together: the causes of the earlier one hold for both, everyday deviations stay or come and "
    "go from day to day, and a change is what only the later log shows. Intervals are of the change, 90 %."
)
_LEVELS: dict[str, Any] = {"unchanged": "good", "identified": "look", "ambiguous": "look", "unexplained": "bad"}


def since_card(found: Diagnosis) -> list[str]:
    """What changed, by how much; nothing where no earlier log was given."""
    since = found.since
    if since is None:
        return []
    parts = [page.badge(_LEVELS[since["verdict"]], since["verdict"]), f"<p>{page.esc(since['sentence'])}</p>"]
    sets = [since["changes"], *since["equivalent"]]
    for i, changes in enumerate(sets):
        if not changes:
            continue
        if len(sets) > 1:
            parts.append(f"<h4>{'What fits best' if i == 0 else f'Alternative {i}'}</h4>")
        parts.append(page.table(["what", "parameter", "before", "now", "change", "90 %"], _rows(changes)))
    figures = since["statistics"]
    parts.append(
        page.bullets(
            [
                f"Error of the earlier log: {times(figures['left_before'])} {RIGHT}; of the later one "
                f"{times(figures['left_now_without_change'])} without and {times(figures['left_now'])} "
                "with the change.",
                *since["notes"],
            ]
        )
    )
    return [
        page.grid(
            page.card(f"What changed since {since.get('case', 'the earlier log')}", "".join(parts), _NOTE, wide=True)
        )
    ]


def _rows(changes: Iterable[Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for change in changes:
        places = ", ".join(places_of(change))
        for name, p in change["parameters"].items():
            ends = p["ci90"] or p.get("now_ci90") or []
            rows.append(
                [
                    f"{title_of(change['effect'])} {places}".strip(),
                    f"{name.replace('_', ' ')}, {p['unit']}",
                    *("-" if p[key] is None else svg.number(p[key]) for key in ("before", "now", "change")),
                    " to ".join(svg.number(v) for v in ends),
                ]
            )
    return rows
