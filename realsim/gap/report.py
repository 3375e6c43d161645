"""report.html of a diagnosis: where, what, how much on the first screen, then the evidence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from realsim.files import write_text
from realsim.gap.diagnosis import Diagnosis
from realsim.gap.groups import kind_of
from realsim.gap.report_robot import robot_view
from realsim.gap.where import PHASES
from realsim.report import page, svg, viewer3d

LEVELS: dict[str, page.Level] = {"no_gap": "good", "identified": "good", "ambiguous": "look", "unexplained": "bad"}
RED = ((255, 255, 255), (253, 212, 158), (252, 141, 89), (215, 48, 31), (127, 0, 0))


def write_report(path: Path, found: Diagnosis) -> None:
    """Write the self-contained page."""
    write_text(path, render(found))


def render(found: Diagnosis) -> str:
    """The page as text."""
    simulator = found.evidence["simulator"]
    case = simulator.case
    parts = [
        page.verdict(LEVELS[found.verdict], found.sentence, found.statistics["reasons"]),
        page.facts(_facts(found)),
        page.grid(
            page.card(
                "Where", _where(found), "Share of the squared gap above the floor, by joint and phase of motion."
            ),
            page.card(
                "What", _what(found), "Gain in log-likelihood of each effect at its best place, alone or on top."
            ),
            page.card("How much", _how_much(found), "Squared error on unseen runs; 1 is the nominal simulator."),
        ),
        page.card("Worst moments, before and after", _overlays(found), wide=True),
        page.card("Robot", robot_view(found), "Colour: share of the gap at each joint's link.", wide=True),
        page.card("Causes", _causes(found), wide=True),
        page.card("All effects tried", _ranking(found), wide=True),
        page.card("Error by horizon and signal", _horizons(found), wide=True),
        page.card("Data health", _health(found), wide=True),
        page.card("Apply the patch", page.code(_howto(found)), wide=True),
    ]
    title = f"Gap of {case.folder.name}"
    subtitle = f"{len(case.joint_names)} joints, {case.base} base, {len(case.runs)} runs, torque {case.torque_kind}"
    return page.document(title, subtitle, "".join(parts), scripts=[viewer3d.script()])


def _facts(found: Diagnosis) -> list[tuple[str, str, str]]:
    s, stats = found.shrinkage, found.statistics
    low, high = s["ci90"]
    seen = "on runs that no fit has seen" if s["unseen"] else "on the fitted runs: no other was left"
    return [
        ("verdict", found.verdict.replace("_", " "), "what the log supports"),
        ("error removed", f"{s['fraction']:.0%}", f"[{low:.0%}, {high:.0%}] {seen}"),
        ("gap", f"{stats['gap_over_floor']:.1f}", "mean square in units of the noise floor"),
        ("unexplained", f"{found.unexplained_share:.0%}", "of the gap above the floor"),
        ("time", f"{stats['seconds']:.0f} s", f"{stats['simulated_seconds']:.0f} simulated seconds") if "seconds" in stats
        else ("runs", str(len(stats["fitted_runs"])), "fitted"),
    ]  # fmt: skip


def _where(found: Diagnosis) -> str:
    """Heat map of channels (joints, base axes) by phase."""
    comparison = found.evidence["comparison"]
    shares = found.evidence["shares"]
    labels = list(dict.fromkeys(c.label for c in comparison.channels))
    grid = np.zeros((len(labels), len(PHASES)))
    for c, channel in enumerate(comparison.channels):
        grid[labels.index(channel.label)] += shares[c]
    keep = np.argsort(-grid.sum(axis=1))[:12]
    keep = np.sort(keep)
    top = float(grid.max()) or 1.0
    rows = []
    for i in keep:
        cells = [f'<span style="background:{_shade(v / top)}">{v:.0%}</span>' for v in grid[i]]
        rows.append([labels[i], *cells])
    return page.table(["", *PHASES], rows, raw=range(1, len(PHASES) + 1))


def _shade(level: float) -> str:
    r, g, b = (int(255 - (255 - c) * min(max(level, 0), 1)) for c in (240, 110, 80))
    return f"rgb({r},{g},{b});color:#111;padding:2px 6px;border-radius:4px"


def _what(found: Diagnosis) -> str:
    rows = [r for r in found.ranking if r.get("gain") is not None][:8]
    if not rows:
        return page.bullets([], "No effect gains anything beyond the everyday deviations.")
    accepted = {c["effect"] for c in found.causes}
    return svg.bars(
        [svg.Bar(r["effect"], max(r["gain"], 0.0), fill=svg.color(1 if r["effect"] in accepted else 0)) for r in rows],
        x_label="gain in log-likelihood",
    )


def _how_much(found: Diagnosis) -> str:
    s = found.shrinkage
    low, high = s["ci90"]
    items = [svg.Bar("nominal", 1.0), svg.Bar("diagnosed", s["after"], 1 - high, 1 - low, fill=svg.color(1))]
    for name, value in s["baselines"].items():
        if name != "nominal" and value == value:
            items.append(svg.Bar(name.split(" (")[0], min(value, 1.5), fill=svg.color(2), text=f"{value:.2f}"))
    return svg.bars(items, x_label="squared error, nominal = 1")


def _overlays(found: Diagnosis) -> str:
    """Log, nominal and diagnosed simulator around the worst moment of the channels that hold most of the gap."""
    simulator, comparison, fit = (found.evidence[k] for k in ("simulator", "comparison", "fit"))
    shares = found.evidence["shares"].sum(axis=1)
    run = int(np.argmax([np.nansum(r**2 / comparison.floor(i)) for i, r in enumerate(found.evidence["residuals"])]))
    before = found.evidence["residuals"][run]
    after = comparison.residual(run, simulator.simulate(fit.settings(), runs=[run])[0])
    time = comparison.times[run]
    plots = []
    for c in np.argsort(-shares)[:4]:
        channel = comparison.channels[c]
        plots.append(
            svg.line(
                [svg.Series("nominal", time, before[:, c]), svg.Series("diagnosed", time, after[:, c])],
                x_label="s",
                y_label=f"{channel.signal} {channel.label}, log - simulator",
                rules=[(0.0, "")],
            )
        )
    name = simulator.case.runs[run].name
    return f'<p class="note">{page.esc(name)}: measured minus simulated</p>' + page.grid(*plots)


def _causes(found: Diagnosis) -> str:
    if not found.causes:
        return page.bullets([], "none")
    rows = []
    for group, causes in [("cause", found.causes), *((f"instead {i + 1}", s) for i, s in enumerate(found.equivalent))]:
        for c in causes:
            values = ", ".join(
                f"{n} {p['value']:.4g} {p['unit']} [{p['ci90'][0]:.4g}, {p['ci90'][1]:.4g}]"
                for n, p in c["parameters"].items()
            )
            place = ", ".join(c.get("joints") or c.get("bodies") or ["everywhere"])
            rows.append([group, c["effect"], place, values, f"{c['probability']:.2f}"])
    return page.table(["", "effect", "where", "values [90 %]", "probability"], rows)


def _ranking(found: Diagnosis) -> str:
    def figure(value: Any) -> str:
        return "" if value is None else f"{value:.1f}"

    rows = [
        [
            r["effect"],
            ", ".join(r.get("place") or [])[:60],
            figure(r.get("linear_gain")),
            figure(r.get("gain")),
            figure(r.get("heldout_gain")),
            figure(r.get("heldout_se")),
            r["outcome"],
        ]
        for r in found.ranking
    ]
    head = ["effect", "best place", "screen", "gain", "per unseen run", "±", "outcome"]
    return page.fold(f"{len(rows)} effects", page.table(head, rows))


def _horizons(found: Diagnosis) -> str:
    stats = found.statistics
    left = svg.bars(
        [svg.Bar(k, 1e3 * v) for k, v in stats["error_by_horizon_rad"].items()], x_label="joint error growth, mrad rms"
    )
    right = svg.bars([svg.Bar(k, v) for k, v in stats["by_signal"].items()], x_label="share of the gap")
    rows = [
        [k, f"{v['rms_before']:.4g}", f"{v['rms_after']:.4g}", f"{v['floor']:.4g}"]
        for k, v in found.shrinkage["per_signal"].items()
    ]
    return page.grid(left, right) + page.table(["signal", "rms before", "rms after", "floor"], rows)


def _health(found: Diagnosis) -> str:
    h = found.health
    lines = [
        f"sample step {1e3 * h['clock']['median_step_s']:.2f} ms, jitter {1e3 * h['clock']['jitter_s']:.2f} ms",
        f"encoder step {1e3 * h['quantum']['joint_pos']:.3g} mrad",
        *(f"{share:.1%} of {name} is missing" for name, share in h["missing"].items()),
        *h["warnings"],
    ]
    return page.bullets(lines)


def _howto(found: Diagnosis) -> str:
    joints = sorted({kind_of(j) for c in found.causes for j in c.get("joints", [])})
    about = f"# changes: {', '.join(c['effect'] for c in found.causes) or 'nothing'} {', '.join(joints)}".rstrip()
    return "\n".join(
        [
            about,
            "import json, mujoco",
            "from realsim.gap import apply_patch",
            "",
            'patch = json.load(open("diagnosis.json"))["patch"]',
            'spec = mujoco.MjSpec.from_file("model.xml")      # the nominal model',
            "wrappers = apply_patch(spec, patch)               # delays, encoder zeros: for your stepping loop",
            "model = spec.compile()",
        ]
    )
