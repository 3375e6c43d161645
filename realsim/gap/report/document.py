"""report.html of a diagnosis: where, what and how much on the first screen, then the evidence.

    write_report(folder / "report.html", found)

The page shows what a `Diagnosis` holds. All that it simulates are the runs of the check, before and after, to draw
them; where they cannot be drawn it says why and leaves the drawing out.
"""

from __future__ import annotations

from pathlib import Path

from realsim.files import write_text
from realsim.gap.answer.diagnosis import Diagnosis
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
from realsim.gap.report.series import Replay, replay
from realsim.gap.report.since import since_card
from realsim.gap.report.where import evidence_cards
from realsim.gap.report.words import LEVELS, WORDS, lead, percent, times
from realsim.report import page, viewer3d

# Three cards in a row on a screen, one below the other on a phone.
_TRIO = 'class="grid" style="grid-template-columns:repeat(auto-fit,minmax(min(300px,100%),1fr));align-items:stretch"'


def write_report(path: Path, found: Diagnosis) -> None:
    """Write the page of a diagnosis to the file `path`."""
    write_text(Path(path), diagnosis_page(found))


def diagnosis_page(found: Diagnosis) -> str:
    """The whole page as text."""
    shown = replay(found)
    trio = "".join([where_card(found), what_card(found), how_much_card(found, shown)])
    body = [
        _banner(found),
        f"<div {_TRIO}>{trio}</div>",
        page.facts(_facts(found)),
        *since_card(found),
        page.grid(overlays_card(found, shown)),
        *_evidence(found, shown),
    ]
    return page.document(*_title(found, shown), "".join(body), scripts=[viewer3d.script()])


def _evidence(found: Diagnosis, shown: Replay) -> list[str]:
    """Everything below the plots; without causes, what the data are like moves up to where they would stand."""
    robot = [robot_card(found), *path_card(found)]
    answer = [*causes_card(found), *equivalents_card(found), *patch_card(found)]
    rests = assumptions_card(found, shown)
    more = evidence_cards(found, shown)
    if not answer:
        return [page.columns([*robot, rests], [*more, health_card(found)]), page.grid(ranking_card(found))]
    left, right = [*answer, health_card(found)], [*robot[:1], *more, *robot[1:]]
    (right if equivalents_card(found) else left).append(rests)  # the shorter column
    return [page.columns(left, right), page.grid(ranking_card(found))]


def _title(found: Diagnosis, shown: Replay) -> tuple[str, str]:
    said = found.statistics
    parts = [f"{said['logged_seconds']:g} s of log" if "logged_seconds" in said else ""]
    if shown.case is not None:
        runs, joints = len(shown.case.runs), len(shown.case.joint_names)
        parts += [f"{runs} run{'s' * (runs != 1)}", f"{joints} joint{'s' * (joints != 1)}"]
    if "seconds" in said:
        parts.append(f"diagnosed in {said['seconds']:.0f} s with {said.get('simulated_seconds', 0):.0f} simulated")
    name = "" if shown.case is None or not shown.case.folder.name else f" of {shown.case.folder.name}"
    return f"Sim-to-real gap{name}", ", ".join(filter(None, parts))


def _banner(found: Diagnosis) -> str:
    """The verdict in one word and one sentence, and where the gap lies in another."""
    small = lead(found)
    note = f"<ul><li>{page.esc(small)}</li></ul>" if small else ""
    return (
        f'<section class="verdict {LEVELS[found.verdict]}"><div class="word">{WORDS[found.verdict]}</div>'
        f"<div><h2>{page.esc(found.sentence)}</h2>{note}</div></section>"
    )


def _facts(found: Diagnosis) -> list[tuple[str, str, str]]:
    shrunk, said = found.shrinkage, found.statistics
    size = said.get("gap_over_floor")
    facts = []
    if size is not None:
        facts.append(("Error of the simulator", times(size**0.5), "the noise floor (root mean square)"))
        if found.causes:
            after = max(size * shrunk["after"], 0.0) ** 0.5
            facts.append(("With the patch", times(after), "the noise floor; causes only"))
    if found.causes:
        low, high = (percent(v) for v in shrunk["ci90"])
        note = f"{low} to {high} (90 %)" if low != high else "90 % interval within rounding"
        facts.append(("Squared error removed", percent(shrunk["fraction"]), note))
    if found.verdict != "no_gap":
        facts.append(("Unexplained", percent(found.unexplained_share), "of the gap, beyond everyday deviations"))
    unseen = shrunk.get("unseen", True)
    names = ", ".join(shrunk.get("runs", []))
    facts.append(("Checked on", names or "no run", "no fit has seen it" if unseen else "also fitted: no run to spare"))
    warnings = len(found.health.get("warnings", []))
    facts.append(("Data health", f"{warnings} warning{'s' * (warnings != 1)}" if warnings else "good", "see below"))
    return facts
