"""report.html of a diagnosis: where, what and how much on the first screen, then the evidence.

    write_report(folder / "report.html", found)

The page shows what a `Diagnosis` holds and simulates nothing; what it cannot draw is left out, and it says why.
"""

from pathlib import Path

from realsim.core.files import write_text
from realsim.gap.answer.brief import NOTHING_KNOWN, Row, brief
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.answer.verdict import RIGHT
from realsim.gap.report.evidence import (
    assumptions_card,
    causes_card,
    equivalents_card,
    patch_card,
    ranking_card,
)
from realsim.gap.report.health import health_card
from realsim.gap.report.overlays import overlays_card, path_card
from realsim.gap.report.plots import how_much_card, what_card, where_card
from realsim.gap.report.robot import robot_card
from realsim.gap.report.since import since_card
from realsim.gap.report.where import evidence_cards
from realsim.gap.report.words import times
from realsim.gap.verdicts import WORDINGS, GapVerdict
from realsim.report import page, viewer3d

_PARTS = 'style="display:grid;gap:6px 26px;grid-template-columns:repeat(auto-fit,minmax(min(210px,100%),1fr))"'


def write_report(path: Path, found: Diagnosis) -> None:
    """Write the page of a diagnosis to the file `path`."""
    write_text(Path(path), diagnosis_page(found))


def diagnosis_page(found: Diagnosis) -> str:
    """The whole page as text."""
    body = [
        _banner(found),
        page.columns([where_card(found), what_card(found)], [how_much_card(found)]),
        page.facts(_facts(found)),
        *since_card(found),
        page.grid(overlays_card(found)),
        *_evidence(found),
    ]
    return page.document(*_title(found), "".join(body), scripts=[viewer3d.script()])


def _evidence(found: Diagnosis) -> list[str]:
    """Everything below the plots; without causes, what the data are like moves up to where they would stand."""
    robot = [robot_card(found), *path_card(found)]
    answer = [*causes_card(found), *equivalents_card(found), *patch_card(found)]
    rests = assumptions_card(found)
    more = evidence_cards(found)
    if not answer:
        return [page.columns([*robot, rests], [*more, health_card(found)]), page.grid(ranking_card(found))]
    left, right = [*answer, health_card(found)], [*robot[:1], *more, *robot[1:]]
    (right if equivalents_card(found) else left).append(rests)  # the shorter column
    return [page.columns(left, right), page.grid(ranking_card(found))]


def _title(found: Diagnosis) -> tuple[str, str]:
    statistics, case = found.statistics, None if found.evidence is None else found.evidence.case
    parts = [f"{statistics['logged_seconds']:g} s of log" if "logged_seconds" in statistics else ""]
    if case is not None:
        runs, joints = len(case.runs), len(case.joint_names)
        parts += [f"{runs} run{'s' * (runs != 1)}", f"{joints} joint{'s' * (joints != 1)}"]
    if "seconds" in statistics:
        simulated = statistics.get("simulated_seconds", 0)
        parts.append(f"diagnosed in {statistics['seconds']:.0f} s with {simulated:.0f} s of simulation")
    name = "" if case is None or not case.folder.name else f" of {case.folder.name}"
    return f"Sim-to-real gap{name}", ", ".join(filter(None, parts))


def _banner(found: Diagnosis) -> str:
    """The verdict in a word and a line; then cause, error, and where or why, and what to do."""
    wording = WORDINGS[GapVerdict(found.verdict)]
    parts = brief(found.as_dict())
    named = {"cause": "Cause", "size": "Error", "evidence": "Why" if found.verdict == "no_gap" else "Where"}
    cells = [f"<div><h4>{name}</h4>{_rows(parts[key])}</div>" for key, name in named.items() if parts[key]]
    todo = f"<p><b>Next:</b> {page.esc(found.advice)}.</p>" if found.advice else ""
    return (
        f'<section class="verdict {wording.level}"><div class="word">{wording.word}</div>'
        f"<div><h2>{page.esc(found.sentence)}</h2>"
        f"<div {_PARTS}>{''.join(cells)}</div>{todo}</div></section>"
    )


def _rows(rows: list[Row]) -> str:
    """One line a row; of labels only those are kept that change what a row says."""
    kept = {"or": "or: ", "rest": "the rest looks "}
    return "".join(f"<div>{kept.get(label, '')}{page.esc(text or NOTHING_KNOWN)}</div>" for label, text in rows)


def _facts(found: Diagnosis) -> list[tuple[str, str, str]]:
    statistics = found.statistics
    size, facts = statistics.get("gap_over_floor"), []
    if size is not None:
        facts.append(("Error of the simulator", times(size**0.5), f"{RIGHT} (root mean square)"))
        if found.causes:
            after = max(size * found.shrinkage["after"], 0.0) ** 0.5
            facts.append(("With the patch", times(after), "that; causes only"))
    runs, unseen = found.shrinkage.get("runs", []), found.shrinkage.get("unseen", True)
    note = "held out: nothing was fitted to it, the verdict is decided with it" if unseen else "no run was held out"
    facts.append(("Checked on", ", ".join(runs[:3]) + (" …" if len(runs) > 3 else "") or "no run", note))
    warnings = len(found.health.get("warnings", []))
    facts.append(("Data health", f"{warnings} note{'s' * (warnings != 1)}" if warnings else "good", "see below"))
    return facts
