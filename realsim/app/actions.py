"""What can be started from the page: each action is a command with a few of its options."""

from dataclasses import dataclass
from pathlib import Path

from realsim.core.errors import RealsimError


@dataclass(frozen=True)
class Field:
    """One option as an input of the page."""

    option: str
    """As on the command line."""
    label: str
    choices: tuple[str, ...] = ()
    """Values to choose from, the first one preset; a text input if there are none."""
    needed: bool = False
    path: bool = False
    """Whether the value is a path below the page's folder."""


@dataclass(frozen=True)
class Action:
    """A command that the page starts on what was opened."""

    command: str
    title: str
    suffix: str
    """Added to the input's name, it is the folder of the result."""
    fields: tuple[Field, ...] = ()


AUTO = "as found"
"""The choice that leaves an option out."""
ACTIONS = {
    a.command: a
    for a in (
        Action(
            "reconstruct", "Reconstruct a scene", "scene",
            (Field("--robot", "robot on the start", (AUTO, "g1", "quadruped")), Field("--keep", "keep", (AUTO, "all"))),
        ),
        Action(
            "contact", "Make collision geometry", "contact",
            (Field("--unit", "unit", (AUTO, "m", "cm", "mm", "inch")), Field("--up", "up", (AUTO, "z", "y"))),
        ),
        Action("diagnose", "Diagnose", "diagnosis", (Field("--max-causes", "causes at most", (AUTO, "1", "2")),)),
        Action("log", "Make a case", "case", (Field("--model", "model of the robot (MJCF)", needed=True, path=True),)),
        Action(
            "finetune", "Fine-tune a policy", "tuned",
            (Field("--minutes", "minutes"), Field("--device", "device", (AUTO, "cpu", "cuda"))),
        ),
    )
}  # fmt: skip
WAYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "capture": (("inspect",), ("reconstruct",)),
    "scan": (("inspect",), ("reconstruct", "contact")),
    "mesh": (("inspect",), ("contact", "reconstruct")),
    "bag": (("log",), ("log", "reconstruct")),
    "recording": (("log",), ("log",)),
    "checkpoint": (("log",), ("log",)),
    "case": (("diagnose", "--check"), ("diagnose",)),
    "network": (("model", "inspect"), ()),
    "scene": ((), ("finetune",)),
}
"""Kind of `realsim.core.recognise` -> the command that says what is recognised, less the path at its end, and the
actions that fit. Of other kinds the page says what can be done with them."""
FORMATS = ("mjcf", "usd", "urdf", "sdf", "glb", "obj", "heightmap")
"""Of `realsim export`, as buttons."""


def arguments_of(action: Action, source: Path, out: Path, values: dict[str, str]) -> tuple[str, ...]:
    """The command's arguments. `values`: option -> what was entered; empty ones and AUTO are left out.

    Raises:
        RealsimError: a needed value is missing.
    """
    chosen = [action.command, str(source), "--out", str(out)]
    for field in action.fields:
        value = values.get(field.option, "").strip()
        if value and value != AUTO:
            chosen.append(f"{field.option}={value}")  # with "=", a value cannot be taken for another option
        elif field.needed:
            raise RealsimError(f"{field.label} is missing", expected=f"a value for {field.option}")
    return tuple(chosen)


def free_folder(root: Path, source: Path, suffix: str) -> Path:
    """A folder beside nothing that is there: NAME_suffix, NAME_suffix_2, ..."""
    first = root / f"{source.stem or 'result'}_{suffix}"
    candidates = [first, *(first.with_name(f"{first.name}_{k}") for k in range(2, 1000))]
    return next(path for path in candidates if not path.exists())
