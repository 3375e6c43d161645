"""More on where the gap lies: torques and wrenches that lack."""

from typing import Any

import numpy as np

from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.report.words import percent, short
from realsim.report import page, svg

_POINTS = 500
"""At most this many points of a scatter plot."""


def evidence_cards(found: Diagnosis) -> list[str]:
    """The cards that this log can fill."""
    return [*_torque_card(found), *_wrench_card(found)]


def _torque_card(found: Diagnosis) -> list[str]:
    """Torque that inverse dynamics does not explain, against the velocity, of the joint that lacks most."""
    residuals = found.statistics.get("torque_residual")
    if not residuals:
        return []
    order = sorted(residuals, key=lambda j: -residuals[j]["share"] * (residuals[j]["explains"] + 0.05))
    rows = [
        [
            short(j, 24),
            f"{svg.number(residuals[j]['rms_Nm'], 2)} N m",
            percent(residuals[j]["share"]),
            _term(residuals[j]),
        ]
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
    text = f"The vertical force weighs {svg.number(mass, 2)} kg ({'more' if mass > 0 else 'less'} than the model)."
    note = (
        "Mean force (world axes) and torque (the base's axes) that the rows without a motor lack, contact forces taken "
        "from the legs' torques. A payload or a push shows here, an effect in a joint does not."
    )
    body = page.table(["axis", "missing", "90 % interval"], rows) + f'<p class="note">{page.esc(text)}</p>'
    return [page.card("Wrench that the base lacks", body, note)]
