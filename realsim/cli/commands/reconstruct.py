"""`realsim reconstruct`: one capture, or many."""

from pathlib import Path
from typing import Annotated, Any

import tyro

from realsim import pipeline
from realsim.cli.commands import CommandResult, strict_exit, verdict_lines
from realsim.cli.commands.many import run_each
from realsim.core.errors import RealsimError
from realsim.core.types import Reconstruction
from realsim.jobs import ManyConfig
from realsim.report.verdict import dropped_frames, judge

SHOWN = 4
"""Reasons for dropped frames, and things cut away, that the terminal lists; the report has all."""


def reconstruct(
    frames: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FRAMES ...", help_behavior_hint="")
    ],
    config: pipeline.ReconstructConfig,
    out: Path = Path("scene"),
    strict: bool = False,
    many: ManyConfig = ManyConfig(),
) -> CommandResult:
    """Turn a folder of RGB-D frames (or a scan) into a MuJoCo scene: metric, level, facing the goal, checked.

    Args:
        frames: one capture or scan; or several, each of which gets a folder of its name below --out.
        out: the scene's folder.
        strict: exit with code 3 if the verdict is "do not use" (the scene is written all the same).
    """
    if not frames:
        raise RealsimError(
            "no capture given", expected="realsim reconstruct FRAMES --out scene/", hint="realsim help reconstruct"
        )
    if len(frames) == 1 and many.place == "processes":
        result = pipeline.reconstruct(frames[0], out, config)
        verdict = judge(result).as_dict()
        text = "\n".join([*verdict_lines(verdict), *_summary(result)])
        data = {"verdict": verdict, **_data(result)}
        return CommandResult(text, data, strict_exit(verdict, strict), verdict["level"])
    return run_each("reconstruct", frames, out, many, shows="scene_xml")


def _data(result: Reconstruction) -> dict[str, Any]:
    return {
        "scene": str(result.scene.folder),
        "scene_xml": str(result.scene.scene_xml),
        "report": str(result.scene.folder / "report.html"),
        "seconds": sum(s.seconds for s in result.stages),
        "warnings": list(result.warnings),
        "dropped": [{"name": n, "stage": s, "reason": r} for n, s, r in dropped_frames(result)],
        "cropped": list(result.aligned.cropped),
        "assumptions": [*result.source.assumptions, *result.aligned.assumptions],
    } | ({} if result.changes is None else {"changes": dict(result.changes)})


def _summary(result: Reconstruction) -> list[str]:
    folder, here = result.scene.folder, Path.cwd()
    folder = folder.relative_to(here) if folder.is_relative_to(here) else folder
    lines = [f"scene   {folder / 'scene.xml'}", f"report  {folder / 'report.html'}"]
    if result.points is not None and result.aligned.metric is not None:
        scale = result.aligned.metric.scale
        dropped = dropped_frames(result)
        lines.append(f"frames  {len(result.aligned.metric)} used, {len(dropped)} dropped")
        by_reason: dict[str, list[str]] = {}
        for name, stage, reason in dropped:
            by_reason.setdefault(f"{reason} ({stage})", []).append(name)
        note = [(names[0] if len(names) == 1 else f"{len(names)} frames", why) for why, names in by_reason.items()]
        lines += _first([f"dropped {which}: {why}" for which, why in note], "more reasons")
        lines.append(f"scale   {scale.value:.4f} [{scale.ci90[0]:.4f}, {scale.ci90[1]:.4f}] by {scale.method}")
    if result.changes is not None:
        lines += [f"since   {change['text']}" for change in result.changes["objects"]] or ["since   nothing changed"]
    gravity = result.aligned.gravity
    lines.append(f"level   to within {gravity.tilt_sigma_deg:.2g} degrees (1 sigma)")
    for role in ("start", "goal"):
        platform = result.aligned.platform(role)
        if platform is not None:
            x, y, z = platform.centroid
            lines.append(f"{role:<7} {x:+.3f} {y:+.3f} {z:+.3f} m, {platform.size[0]:.2f} x {platform.size[1]:.2f} m")
    lines += [f"frame   {note}" for note in result.aligned.assumptions]
    width, depth, height = (result.aligned.bounds[1] - result.aligned.bounds[0]).tolist()
    lines.append(f"kept    {width:.2f} x {depth:.2f} x {height:.2f} m of the capture")
    lines += _first([f"cut     {note}" for note in result.aligned.cropped], "more objects")
    lines.append(f"mesh    {result.mesh.quality.triangles} triangles, {result.mesh.method}")
    lines.append(f"time    {sum(s.seconds for s in result.stages):.1f} s")
    return lines + [f"note    {w}" for w in result.warnings]


def _first(lines: list[str], what: str) -> list[str]:
    """The first few, and how many are left out."""
    left = len(lines) - SHOWN
    many = what if left > 1 else what.removesuffix("s")
    return lines if left <= 0 else [*lines[:SHOWN], f"        and {left} {many}: see the report"]
