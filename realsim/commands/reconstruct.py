"""`realsim reconstruct`: one capture, or many."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from realsim import pipeline
from realsim.commands import CommandResult
from realsim.commands.many import run_each
from realsim.errors import RealsimError, require
from realsim.types import Reconstruction


def reconstruct(
    frames: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FRAMES ...", help_behavior_hint="")
    ],
    config: pipeline.ReconstructConfig,
    out: Path = Path("scene"),
    jobs: int = 1,
    ray: str | None = None,
) -> CommandResult:
    """Turn a folder of RGB-D frames (or a scan) into a MuJoCo scene: metric, level, facing the goal, checked.

    Args:
        frames: one capture or scan; or several, each of which gets a folder of its name below --out.
        out: the scene's folder.
        jobs: with several captures: how many at a time on this machine.
        ray: with several captures: the address of a Ray cluster that shares this file system.
    """
    if not frames:
        raise RealsimError("no capture given", expected="realsim reconstruct FRAMES --out scene/")
    if len(frames) == 1 and ray is None:
        require("recon", "realsim reconstruct")
        result = pipeline.reconstruct(frames[0], out, config)
        return CommandResult(_summary(result), _data(result))
    return run_each("reconstruct", frames, out, shows="scene_xml", jobs=jobs, ray=ray)


def _data(result: Reconstruction) -> dict[str, Any]:
    return {
        "scene": str(result.scene.folder),
        "scene_xml": str(result.scene.scene_xml),
        "report": str(result.scene.folder / "report.html"),
        "seconds": sum(s.seconds for s in result.stages),
        "warnings": list(result.warnings),
    }


def _summary(result: Reconstruction) -> str:
    lines = [f"scene   {result.scene.scene_xml}", f"report  {result.scene.folder / 'report.html'}"]
    if result.points is not None and result.aligned.metric is not None:
        scale = result.aligned.metric.scale
        lines.append(
            f"frames  {len(result.points)} used, {len(result.points.dropped) + len(result.source.dropped)} dropped"
            if hasattr(result.source, "dropped")
            else f"frames  {len(result.points)} used"
        )
        lines.append(f"scale   {scale.value:.4f} [{scale.ci90[0]:.4f}, {scale.ci90[1]:.4f}] by {scale.method}")
    gravity = result.aligned.gravity
    lines.append(f"level   to within {gravity.tilt_sigma_deg:.2f} degrees (1 sigma)")
    for role in ("start", "goal"):
        platform = result.aligned.platform(role)
        if platform is not None:
            x, y, z = platform.centroid
            lines.append(f"{role:<7} {x:+.3f} {y:+.3f} {z:+.3f} m, {platform.size[0]:.2f} x {platform.size[1]:.2f} m")
    lines.append(f"mesh    {result.mesh.quality.triangles} triangles, {result.mesh.method}")
    lines.append(f"time    {sum(s.seconds for s in result.stages):.1f} s")
    lines += [f"note    {w}" for w in result.warnings]
    return "\n".join(lines)
