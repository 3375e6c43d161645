"""README's table."""

from benchmarks.scenes import reconstruct
from benchmarks.tables.diagnosis import real_figures
from benchmarks.tables.fresh import DRAWN, measures, rows_of
from benchmarks.tables.policies import families, minute_base, well_crossed
from benchmarks.tables.stored import of, span, stored


def readme() -> list[str]:
    """The README's one table: nine rows, the strict figure before the lenient one."""
    scenes = {
        mode: [
            r for r in stored("reconstruct")["rows"]
            if r["capture"] in reconstruct.NAMES and r["method"] == f"realsim, poses {mode}"
        ]
        for mode in reconstruct.MODES
    }  # fmt: skip
    found, real = measures(rows_of()), real_figures()
    exact = found["one or two: `identified`, with exactly the true causes"]
    pushed = " / ".join(families(difficulty, "full") for difficulty in ("0.5", "0.8"))
    contact = next(line for line in stored("contact")["summary"] if line.startswith("| `auto` | 13 exact")).split("|")
    seconds = [r["seconds"] for rows in scenes.values() for r in rows]
    rows = [
        (
            "Scene: height of obstacles, poses given / unknown",
            " / ".join(f"{span([r['delivered_tops_mm'] for r in rows], '{:.1f}')} mm" for rows in scenes.values()),
            "3 rendered captures with sensor noise",
        ),
        (
            "Scene: error of scale, poses given / unknown",
            " / ".join(f"{span([100 * r['scale_error'] for r in rows], '{:.2f}')} %" for rows in scenes.values()),
            "the same",
        ),
        (
            "Scene: time",
            f"{span(seconds, '{:.0f}')} s",
            "60 frames, two cores",
        ),
        (
            "Contact: deviation from the mesh, median / 95th percentile",
            f"{contact[3].strip()} / {contact[4].strip()} mm",
            "worst of 13 meshes",
        ),
        (
            "Diagnosis: `identified` with exactly the true cause / with pairs",
            f"{of(found['one cause: `identified`, with exactly that cause'])} / {of(exact)}",
            f"{len(rows_of())} of {sum(DRAWN.values())} logs, never seen: seed {', '.join(map(str, DRAWN))}",
        ),
        (
            "Diagnosis: cause named first / false alarms",
            f"{of(found['one cause, named first'])} / {of(found['nothing wrong, something named'])}",
            "the same",
        ),
        (
            "Real robots: error named first / both of two / surely wrong",
            f"{of(real['single_first_right'])} / {of(real['double_both_right'])} / {of(real['confident_and_wrong'])}",
            "known errors in two models",
        ),
        (
            "G1's base policy, difficulty 0.5 / 0.8 / 1, mean and worst family",
            " / ".join(families(difficulty) for difficulty in ("0.5", "0.8", "1")),
            f"simulation; with pushes {pushed}",
        ),
        (
            "Fine-tuned one minute: terrains crossed in 97 % of trials",
            well_crossed(),
            f"no pushes, one H200, {minute_base()}",
        ),
    ]
    return ["| | figure | measured on |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)]
