"""The part of the report about the data: clock, gaps, resolution, noise, starts, saturation, and what was odd."""

from collections import Counter
from typing import Any

import numpy as np

from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.case.model.channels import UNITS
from realsim.gap.report.words import percent, short, signal_name
from realsim.report import page, svg

_SATURATED = {"nominal_drive": "at its force range in the simulator", "logged_torque": "logged torque at its top"}


def health_card(found: Diagnosis) -> str:
    """Warnings first, then figures."""
    health = found.health
    warnings = list(health.get("warnings", []))
    badge = page.badge("look", f"{len(warnings)} to look at") if warnings else page.badge("good", "nothing wrong")
    parts = [f"<p>{badge}</p>", page.bullets(warnings) if warnings else ""]
    rows = []
    for key, joints in health.get("saturation", {}).items():
        worst = sorted(joints, key=lambda j: -joints[j])[:4]
        if worst:
            rows.append([_SATURATED[key], ", ".join(f"{short(j)} {percent(joints[j])}" for j in worst)])
    parts.append(page.table(["figure", "value"], [*_clock(health), *_start(health), *rows]))
    signals = _signals(found)
    if signals:
        parts.append(page.table(["signal", "missing", "step", "noise", "repeats", "no gap below"], signals))
        parts.append(
            '<p class="note">Step: the smallest between readings. Noise: of a sample. Repeats: what runs with the same '
            "command differ by. No gap below: slow errors of this size are everyday. In the signal's unit.</p>"
        )
    return page.card("Data health", "".join(parts))


def _clock(health: dict[str, Any]) -> list[list[str]]:
    clock = health.get("clock", {})
    names = {"median_step_s": "sampling step (median)", "jitter_s": "jitter of the time stamps"}
    known = {title: clock[key] for key, title in names.items() if key in clock}
    # No clock of a log resolves a nanosecond: what is less comes from rounding.
    return [[title, "none" if s < 1e-9 else f"{svg.number(1000 * s)} ms"] for title, s in known.items()]


def _start(health: dict[str, Any]) -> list[list[str]]:
    start = health.get("start", {})
    if not start:
        return []
    how = Counter(text.partition(":")[0] for text in start.get("runs", {}).values())
    return [
        *([f"runs started {words}", str(count)] for words, count in how.items()),
        ["start, farthest from the simulator's rest", f"{svg.number(start['farthest_from_rest'], 2)} rad"],
        ["start, fastest joint", f"{svg.number(start['fastest_at_start'], 2)} rad/s"],
    ]


def _signals(found: Diagnosis) -> list[list[str]]:
    """One row a signal."""
    health, kept = found.health, found.evidence
    detail: dict[str, float] = {}
    if kept is not None:
        for signal in dict.fromkeys(c.signal for c in kept.channels):
            columns = [i for i, c in enumerate(kept.channels) if c.signal == signal]
            detail[signal] = float(np.median(kept.detail[columns]))
    rows = []
    for signal in dict.fromkeys([*health.get("noise", {}), *detail]):
        noise = health.get("noise", {}).get(signal, {})
        name = f"{signal_name(signal)}, {UNITS.get(signal, '')}"
        figures = [
            health.get("quantum", {}).get(signal),
            noise.get("sample"),
            noise.get("replicates"),
            detail.get(signal),
        ]
        gone = percent(health.get("missing", {}).get(signal, 0.0))
        rows.append([name, gone, *("–" if v is None else svg.number(v, 2) for v in figures)])
    return rows
