"""`realsim excite`: the recording that decides between the rivals of an ambiguous diagnosis."""

from pathlib import Path
from shlex import quote
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.cli.commands.diagnose import refuse_recording
from realsim.core.errors import RealsimError
from realsim.core.progress import steps
from realsim.gap.config import DiagnoseConfig, ExciteConfig
from realsim.gap.excite import excite as choose


def excite(
    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CASE|DIAGNOSIS", help_behavior_hint="")],
    config: ExciteConfig,
    out: Path = Path("experiment"),
    case: Path | None = None,
    threads: int | None = None,
    overwrite: bool = False,
) -> CommandResult:
    """Choose what to record where a diagnosis could not decide, check the robot's limits, write the commands.

    Args:
        source: the folder of an ambiguous diagnosis; or a case, which is diagnosed first.
        out: gets experiment.json, commands/ (.csv and .npz), README.md and report.html.
        case: the case of a diagnosis, where it is not where it was when it was diagnosed.
        threads: of the simulator; all cores unless told.
        overwrite: replace an experiment that realsim wrote before and for which nothing was recorded.
    """
    if threads is not None and threads < 1:
        raise RealsimError("--threads is too small", expected="at least 1", found=str(threads))
    refuse_recording(source)
    settings = DiagnoseConfig() if threads is None else DiagnoseConfig(threads=threads)
    with steps() as tick:
        plan = choose(source, out, config, settings, tick, case=case, overwrite=overwrite)
    lines = [f"record     {plan['text']}"]
    lines += [f"  {i}. {line}" for i, line in enumerate(plan["instructions"], 1)]
    lines += [f"commands   {out / name}" for name in plan["files"]]
    lines.append(f"report     {out / 'report.html'}")
    where = case or (source if (source / "log.json").is_file() else "CASE")
    lines.append(f"then       realsim diagnose {quote(str(where))} {quote(str(out))} --out decided")
    level = "good" if plan["decides"] else "look"
    return CommandResult("\n".join(lines), plan, 0, level)
