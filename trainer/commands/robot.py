"""`realsim robot`: a robot of one's own, from its model to one that can be trained."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.errors import RealsimError
from realsim.core.files import refuse_file, write_text
from trainer.errors import TrainerError


def robot(
    what: Annotated[Literal["new", "check"], tyro.conf.Positional],
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(name="file")],
    out: Path | None = None,
    overwrite: bool = False,
) -> CommandResult:
    """Take a robot of your own from its model (MJCF, URDF): `new` guesses a small file, `check` tries what it says.

    `new` writes actuated joints with default pose, gains and limits, feet, base and camera, each with its reason beside
    it; correct what is wrong. `check` stands the robot up, drops it, moves its joints one by one and compares left and
    right. Then `--robot FILE` trains it, or a package's entry point in the group `realsim.robots`.

    Args:
        what: new or check
        path: of new the model, .xml or .urdf; of check the file that new wrote (.toml), or a robot's name.
        out: of new, the file; if not given, the model's name with .toml in this folder.
        overwrite: replace a file that is there already.
    """
    from trainer.commands import common  # noqa: F401  names the extra where torch is missing
    from trainer.robots import named

    if what == "new":
        return _new(path, out or Path(f"{path.stem}.toml"), overwrite)
    if out is not None:
        raise TrainerError("a check writes no file", expected="realsim robot check FILE", found=f"--out {out}")
    from trainer.robots.check import check

    findings = check(named(str(path)))
    worst = next((level for level in ("bad", "look") if any(f.level == level for f in findings)), "good")
    words = {"good": "ok", "look": "look at", "bad": "wrong"}
    lines = [f"{words[f.level]:<8} {f.text}" for f in findings]
    return CommandResult("\n".join(lines), {"findings": [asdict(f) for f in findings], "level": worst}, worst == "bad")


def _new(model: Path, out: Path, overwrite: bool) -> CommandResult:
    from trainer.robots.file import load
    from trainer.robots.guess import guess

    if out.suffix != ".toml":
        raise TrainerError("a robot's file is TOML", expected="--out NAME.toml", found=str(out))
    refuse_file(out, overwrite)
    found, reasons = guess(model, out)
    write_text(out, found.text(reasons))
    lines = [f"{key:<14} {reason}" for key, reason in reasons.items() if not key.startswith("joints.")]
    lines.append(f"{len(found.joints)} joints      each with its reason in the file")
    try:
        load(out)
    except RealsimError as error:
        what = ": ".join(filter(None, (error.message, error.found or error.expected)))
        lines.append(f"to correct     {what}. {error.hint or ''}".rstrip())
    return CommandResult(
        "\n".join([*lines, f"robot          {out}: correct it, then realsim robot check {out}"]),
        {"file": str(out), "robot": asdict(found), "reasons": reasons},
    )
