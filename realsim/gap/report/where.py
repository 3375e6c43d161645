"""More on where the gap lies: bins that stand out, how errors grow with the horizon, torques and wrenches that lack."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from realsim.gap.answer.arrays import Arrays
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.report.series import horizons
from realsim.gap.report.words import percent, short, signal_name
from realsim.report import page, svg

_POINTS = 500
"""At most this many points of a scatter plot."""
_READING = {
    "one sample": "Half of it is there after one sample, as with readings and their delays.",
    "20 ms": "Half of it is there within 20 ms, as with drives (gains, delays, limits) or a wrong pose on the ground.",
    "100 ms": "Half of it takes about 100 ms, as with forces that are missing (friction, inertia, load).",
    "500 ms": "Half of it takes half a second, as with slow forces (load, contact, compliance) or drift.",
}


def evidence_cards(found: Diagnosis) -> list[str]:
    """The cards that this log can fill."""
    growth = [] if found.evidence is None else _growth_card(found.evidence)
    return [*growth, *_torque_card(found), *_wrench_card(found)]


def _growth_card(kept: Arrays) -> list[str]:
    """Error over the horizon on two logarithmic axes, one curve a signal; dashed before, full after."""
    signals = [s for s in ("joint_pos", "base_pos", "base_rot") if horizons(kept, s)]
    if not signals:
        return []
    seconds = np.log10(kept.shots[0].seconds)
    place = dict(zip(kept.shots[0].labels, seconds, strict=True))
    rows = {s: horizons(kept, s) for s in signals}
    values = [v for r in rows.values() for _, b, a in r for v in (b, a) if v is not None and v > 0]
    low, high = math.log10(min([0.7, *values])) - 0.1, math.log10(max([3.0, *values])) + 0.1
    steps = (1, 2, 5) if high - low < 2 else (1,)
    tens = [(math.log10(m) + k, svg.number(m * 10.0**k)) for k in range(-2, 7) for m in steps]
    tens = [t for t in tens if low <= t[0] <= high]
    ticks = [(float(x), label) for x, label in zip(seconds, kept.shots[0].labels, strict=True)]
    axes = svg.Axes((float(seconds[0]) - 0.15, float(seconds[-1]) + 0.2), (low, high), height=230, left=44,
                    x_ticks=ticks, y_ticks=tens, x_label="predicted ahead", y_label="error / noise floor")  # fmt: skip
    axes.span(low, 0.0, "var(--good)")
    for i, signal in enumerate(signals):
        for after in (False, True):
            points = [
                (float(place[label]), math.log10(v))
                for label, b, a in rows[signal]
                if (v := a if after else b) is not None and v > 0
            ]
            if points:
                axes.polyline(points, svg.color(i), width=2, dash="" if after else "6 3")
                axes.dots(points, svg.color(i), radius=3)
        axes.legend(signal_name(signal), svg.color(i))
    note = "From states estimated from the log (multiple shooting), nominal dashed"
    note += ", with the diagnosis full." if len(kept.shots) > 1 else "."
    return [page.card("How the error grows", axes.svg("error by horizon") + _reading(rows.get("joint_pos", [])), note)]


def _reading(rows: list[tuple[str, float, float | None]]) -> str:
    """What the growth of the nominal simulator's error says."""
    top = max((b for _, b, _ in rows), default=0.0)
    if top < 2:
        return page.bullets([], "The errors stay near the noise floor at every horizon.")
    first = next(label for label, b, _ in rows if b >= 0.5 * top)
    return f'<p class="note">{page.esc(_READING.get(first, ""))}</p>'


def _torque_card(found: Diagnosis) -> list[str]:
    """Torque that inverse dynamics does not explain, against the velocity, of the joint that lacks most."""
    said = found.statistics.get("torque_residual")
    if not said:
        return []
    order = sorted(said, key=lambda j: -said[j]["share"] * (said[j]["explains"] + 0.05))
    rows = [
        [short(j, 24), f"{svg.number(said[j]['rms_Nm'], 2)} N m", percent(said[j]["share"]), _term(said[j])]
        for j in order[:6]
    ]
    note = "Logged torque less what the nominal equations need for the logged motion; nothing is simulated."
    table = page.table(["joint", "residual (rms)", "of the torque²", "most of it is"], rows)
    return [page.card("Torque that is missing", _scatter(found, order[0]) + table, note)]


def _term(entry: dict[str, Any]) -> str:
    if entry["what"] == "none of these":
        return "no simple law"
    unit = "×" if entry["unit"] == "ratio" else entry["unit"]
    return f"{entry['what']}: {svg.number(entry['value'], 2)} {unit} ({percent(entry['explains'])})"


def _scatter(found: Diagnosis, joint: str) -> str:
    residual = None if found.evidence is None else found.evidence.torque
    if residual is None or joint not in residual.joints:
        return ""
    j = residual.joints.index(joint)
    points = np.column_stack([residual.velocity[:, j], residual.residual[:, j]])
    points = points[np.isfinite(points[:, 1])]
    if not len(points):
        return ""
    points = points[:: max(1, len(points) // _POINTS)]
    axes = svg.Axes(svg.padded(points[:, 0], 0.05), svg.padded(points[:, 1], 0.08), height=190, left=48,
                    x_label=f"velocity of {short(joint, 24)}, rad/s", y_label="N m")  # fmt: skip
    axes.dots(points, "var(--c1)", radius=1.8)
    return axes.svg("missing torque against velocity")


def _wrench_card(found: Diagnosis) -> list[str]:
    """The six unactuated rows, with intervals."""
    wrench = found.statistics.get("base_wrench")
    if not wrench:
        return []
    rows, beyond = [], []
    for axis, v in wrench.items():
        if axis == "mass_kg":
            continue
        low, high = v["ci90"]
        clear = low > 0 or high < 0
        beyond += [axis.replace("_", " ")] if clear else []
        rows.append([axis.replace("_", " "), f"{svg.number(v['value'], 2)} {v['unit']}",
                     f"[{svg.number(low, 2)}, {svg.number(high, 2)}]"])  # fmt: skip
    mass = wrench["mass_kg"]
    said = f"The vertical force weighs {svg.number(mass, 2)} kg ({'more' if mass > 0 else 'less'} than the model)."
    note = (
        "Mean force (world axes) and torque (the base's axes) that the rows without a motor lack, contact forces taken "
        "from the legs' torques. A payload or a push shows here, an effect in a joint does not."
    )
    body = page.table(["axis", "missing", "90 % interval"], rows) + f'<p class="note">{page.esc(said)}</p>'
    return [page.card("Wrench that the base lacks", body, note)]
