"""Tables of captures, scale, contact and damaged files."""

from collections import Counter
from typing import Any

import numpy as np

from benchmarks.scenes import reconstruct
from benchmarks.tables.stored import Row, stored

POSES = {"given": "given", "hidden": "unknown"}


def captures() -> list[str]:
    """Errors of reconstructed captures with exact truth."""
    head = ("scale, %", "tilt, °", "heading, °", "origin, mm", "tops, mm", "F at 1 cm", "F at 2 cm", "seconds")
    lines = [f"| capture | camera poses | {' | '.join(head)} |", "|---|---" + "|---:" * len(head) + "|"]
    for r in stored("reconstruct")["rows"]:
        mode = r["method"].rpartition(" ")[2]
        if r["capture"] in reconstruct.NAMES and mode in POSES:
            lines.append(
                f"| {reconstruct.NAMES[r['capture']]} | {POSES[mode]} | {100 * r['scale_error']:.2f} | "
                f"{r['tilt_deg']:.2f} | {r['yaw_deg']:.2f} | {r['origin_mm']:.1f} | {r['delivered_tops_mm']:.1f} | "
                f"{r['f1']:.3f} | {r['f2']:.3f} | {r['seconds']:.0f} |"
            )
    return lines


def scale() -> list[str]:
    """Error of the metric scale by where points and poses come from, and the paper's figures below."""
    data = stored("scale_error")
    lines = [
        "| source | captures | failed | mean | worst | Stake1 | Narrow1 | 90 % interval holds |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for source, s in data["summary"].items():
        both = [
            [
                r["scale_error"]
                for r in data["rows"]
                if (r["source"], r["terrain"]) == (source, t) and "scale_error" in r
            ]
            for t in data["paper"]
        ]
        cells = [f"{np.mean(errors):.4f}" if errors else "" for errors in both]
        holds = "" if s["coverage"] is None else f"{s['coverage']:.0%}"
        lines.append(
            f"| `{source}` | {s['captures']} | {s['failed']} | {s['mean']:.4f} | {s['worst']:.4f} | "
            f"{' | '.join(cells)} | {holds} |"
        )
    for name in data["paper"]["Stake1"]:
        lines.append(f"| *paper: {name}* | | | | | {' | '.join(str(v[name]) for v in data['paper'].values())} | |")
    return lines


VERDICTS = {"good": "good", "look": "check first", "bad": "do not use", "refused": "refused"}


def real_captures() -> list[str]:
    """What becomes of captures that real sensors and apps wrote."""
    head = [
        "| capture | frames | verdict | platforms, goal | contact median / p95, leaks | side rays that stop | "
        "heights off > 2 cm | CPU, memory | known | found |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    return head + [_real_capture(row) for row in stored("real_captures")["rows"]]


def _real_capture(row: Row) -> str:
    cost = f"{row['cpu_s']:.0f} s, {row['peak_gb']:.1f} GB"
    if row["verdict"] == "refused":
        return f"| {row['capture']} | | refused | | | | | {cost} | {row['known']} | |"
    frames = f"{row['frames']} of {row['frames'] + row['dropped']}" if row["frames"] else "scan"
    sides = "too few" if row["sides_stopped"] is None else f"{100 * row['sides_stopped']:.1f} %"
    contact = f"{row['median_mm']:.1f} / {row['p95_mm']:.1f} mm, {row['leaks']}"
    return (
        f"| {row['capture']} | {frames} | {VERDICTS[row['verdict']]} | {row['platforms']}, "
        f"{'yes' if row['goal'] else 'no'} | {contact} ({row['representation']}) | {sides} | "
        f"{100 * row['heights_off']:.0f} % | {cost} | {row['known']} | {row['found']} |"
    )


def clouds() -> list[str]:
    """Clouds that do not say from where they were seen, against the exact terrain."""
    head = [
        "| terrain | geoms | mesh off, median / p95 | contact off, median / p95 | side rays that stop "
        "| heights off > 2 cm | phantom over gaps, leaks |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    return head + [
        f"| {r['terrain']} | {r['geoms']} (`{r['chosen']}`) | {r['mesh_median_mm']:.1f} / {r['mesh_p95_mm']:.1f} mm | "
        f"{r['median_mm']:.1f} / {r['p95_mm']:.1f} mm | {100 * r['stopped']:.1f} % | {100 * r['heights_off']:.1f} % | "
        f"{r['phantom_over_gaps_cm2']:.0f} cm², {r['leaks']} |"
        for r in stored("clouds")["rows"]
    ]


def movers() -> list[str]:
    """Captures with somebody who moves, or something that moves with the camera."""
    head = [
        "| what | poses | frames | F at 1 cm | tops off | false surface of all | collision parts | said |",
        "|---|---|---:|---:|---:|---:|---:|---|",
    ]
    said = {"": "no", "moves with": "cut: moves with the camera", "moved there": "warned: somebody moved there"}
    lines = []
    for r in stored("movers")["rows"]:
        how = next((words for words in said if words and words in r["said"]), "")
        false = f"{r['false_m2']:.2f} of {r['area_m2']:.1f} m²"
        lines.append(
            f"| {r['kind']} | {r['poses']} | {r['frames']} | {r['f_1cm']:.3f} | {r['tops_mm']:.2f} mm | {false} | "
            f"{r['geoms']} | {said[how]} |"
        )
    return head + lines


def hard_matches() -> list[str]:
    """Captures that are hard to match, without and with the learned matcher."""
    lines = [
        "| capture | changed | frames placed | ATE | worst step | seconds | pairs asked, joined |",
        "|---|---|---|---|---|---|---|",
    ]
    pairs: dict[tuple[Any, ...], dict[bool, Row]] = {}
    for row in stored("matching")["rows"]:
        pairs.setdefault((row["capture"], row["kind"], row["frames"]), {})[row["learned"]] = row
    for pair in (p for p in pairs.values() if len(p) == 2):
        row = pair[True]
        asked = row.get("asked")  # not stored where nothing was placed
        both = [row] if asked == 0 else [pair[False], row]
        placed = " / ".join(str(r["placed"]) for r in both)
        figures = [
            " / ".join(f"{r[k]:.0f}{unit}" if k in r else "-" for r in both)
            for k, unit in (("ate_mm", " mm"), ("worst_step_mm", " mm"), ("seconds", ""))
        ]
        change = "" if row["kind"] == "as it is" else row["kind"]
        joined = "not asked" if asked == 0 else f"{asked}, {row['joined']}" if asked else "-"
        lines.append(
            f"| {row['capture']} | {change} | {placed} of {row['frames']} | {' | '.join(figures)} | {joined} |"
        )
    return lines


def clean_meshes() -> list[str]:
    """Clean meshes of many kinds: verdict, parts, and what gets stuck in a test with balls and capsules."""
    lines = [
        "| mesh | verdict | parts | leaks | 95 %, mm | cost | stuck of dropped |",
        "|---|---|---:|---:|---:|---:|---|",
    ]
    for r in stored("clean_meshes")["rows"]:
        figures = f"{r['parts']} | {r['leaks']} | {r['p95_mm']:.1f} | {r['step_cost']:.1f}"
        verdict = VERDICTS.get(r["verdict"], r["verdict"])
        lines.append(f"| {r['mesh']} | {verdict} | {figures} | {r['stuck']} of {r['dropped']} |")
    return lines


def recordings() -> list[str]:
    """Recordings in many formats and with many headers, read without a hand."""
    rows = stored("recordings")["rows"]
    lines = ["| part | outcome | recordings |", "|---|---|---:|"]
    for part, outcome in sorted({(r["part"], r["outcome"]) for r in rows}):
        lines.append(f"| {part} | {outcome} | {sum((r['part'], r['outcome']) == (part, outcome) for r in rows)} |")
    return lines


def damaged() -> list[str]:
    """What came of damaged files, by what was read, all seeds together."""
    rows = [r for r in stored("fuzz")["rows"] if r["number"] is None]
    harmless = ("moved", "less", "unused", "slight")
    lines = ["| read | trials | refused | warned | same | harmless | cannot be determined | silent | traceback, hang |"]
    lines.append("|" + "---|" * 9)
    for kind in dict.fromkeys(r["kind"] for r in rows):
        n = Counter({k: sum(r[k] for r in rows if r["kind"] == kind) for k in rows[0] if isinstance(rows[0][k], int)})
        counts = [n["trials"], n["refused"], n["said"], n["same"], sum(n[k] for k in harmless)]
        counts += [n["exchanged"] + n["plausible"], n["silent"], n["traceback"] + n["hang"]]
        lines.append(f"| {kind} | " + " | ".join(map(str, counts)) + " |")
    return lines
