"""README's table."""

from __future__ import annotations

from benchmarks.scenes import reconstruct
from benchmarks.tables.diagnosis import robots
from benchmarks.tables.fresh import FRESH, rows_of
from benchmarks.tables.policies import families, well_crossed
from benchmarks.tables.stored import counts, of, span, stored


def readme() -> list[str]:
    """The README's one table: at most eight rows, each with the section of docs/figures.md that it is from."""
    scenes = {
        mode: [
            r for r in stored("reconstruct")["rows"]
            if r["capture"] in reconstruct.NAMES and r["method"] == f"realsim, poses {mode}"
        ]
        for mode in reconstruct.MODES
    }  # fmt: skip
    latest = rows_of(*FRESH)
    fresh = counts(latest)
    measured_on = f"simulated logs, generated after the search was frozen (seed {FRESH[0]}): {robots(latest)}"
    pushed = " / ".join(families(difficulty, "full") for difficulty in ("0.5", "0.8"))
    contact = next(line for line in stored("contact")["summary"] if line.startswith("| `auto` | 13 exact")).split("|")
    seconds = [r["seconds"] for rows in scenes.values() for r in rows]
    rows = [
        (
            "Scene: height of obstacles, camera poses given / unknown",
            " / ".join(f"{span([r['delivered_tops_mm'] for r in rows], '{:.1f}')} mm" for rows in scenes.values()),
            "3 rendered captures with sensor noise",
        ),
        (
            "Scene: error of scale, camera poses given / unknown",
            " / ".join(f"{span([100 * r['scale_error'] for r in rows], '{:.2f}')} %" for rows in scenes.values()),
            "the same; without poses the sensor's own error stays",
        ),
        (
            "Scene: from frames to a checked scene",
            f"{span(seconds, '{:.0f}')} s",
            "60 frames, two cores, no GPU",
        ),
        (
            "Contact: deviation from the mesh, median / 95th percentile, worst mesh",
            f"{contact[3].strip()} / {contact[4].strip()} mm",
            "13 meshes, measured with balls in MuJoCo",
        ),
        (
            "Diagnosis: a single cause is named first / or as an equivalent / both of two",
            f"{of(fresh['first'])} / {of(fresh['with equivalents'])} / {of(fresh['both'])}",
            measured_on,
        ),
        (
            "Diagnosis: a cause is named where nothing is wrong",
            of(fresh["false alarms"]),
            "the same",
        ),
        (
            "Policy: G1 crosses unseen courses of difficulty 0.5 / 0.8, mean and worst of eight families",
            " / ".join(families(difficulty) for difficulty in ("0.5", "0.8")),
            "in simulation, the base that ships, not fine-tuned; little randomisation, no pushes; "
            f"with all of it and pushes {pushed}",
        ),
        (
            "Policy: fine-tuned for five minutes on the terrain in front of it: tests crossed in 97 % of 1000 trials",
            well_crossed(),
            "in simulation, little randomisation, no pushes; one H100 or a part of it; before: 250 trials each",
        ),
    ]
    return ["| | figure | measured on |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)]
