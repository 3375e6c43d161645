"""`realsim lint`: what the static geoms of any MJCF collide as."""

from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult, describe_sides, strict_exit, verdict_lines
from realsim.core.errors import require


def lint(mjcf: Annotated[Path, tyro.conf.Positional], strict: bool = False) -> CommandResult:
    """Measure what a model's static geoms collide as against what is drawn: hulls, phantoms, what is missing, seams.

    Args:
        mjcf: a model that MuJoCo loads; its robots are left out.
        strict: exit with code 3 if the verdict is "do not use".
    """
    require("recon", "realsim lint")
    from realsim.export.lint import lint_mjcf

    found = lint_mjcf(mjcf)
    lines = [
        *verdict_lines(found["verdict"]),
        f"geoms    {found['geoms']}, {len(found['hulls'])} of them hulls that are off their mesh",
        f"error    {found['median_mm']:.1f} mm median, {found['p95_mm']:.1f} mm at the 95th percentile",
        f"phantom  {found['phantom_area_cm2']:.0f} cm2, missing {found['missing_area_cm2']:.0f} cm2",
        f"sides    {describe_sides(found['sides'])}",
        f"seams    {len(found['seams'])} where parts only meet",
        f"leaks    {found['leaks']} of {found['leak_objects']} balls",
        *(f"hull     {hull['geom']}: off by {hull['off_mm']:.0f} mm" for hull in found["hulls"]),
        *(f"seam     {' and '.join(seam['geoms'])} at {seam['at']}" for seam in found["seams"][:20]),
    ]
    verdict = found["verdict"]
    return CommandResult("\n".join(lines), found, strict_exit(verdict, strict), verdict["level"])
