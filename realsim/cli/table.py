"""All commands. One that is added here, or by an entry point of a package, is everywhere: see `Command`."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from realsim.cli.command import Command, Tool
from realsim.core.errors import UnknownNameError

_OWN: dict[str, dict[str, tuple[Any, ...]]] = {
    "Scenes": {
        "reconstruct": (
            "frames or a scan -> a metric, level MuJoCo scene with a report",
            "realsim reconstruct my_capture --out scene --robot g1", "recon",
            ("--out", "--robot", "--overwrite", "--strict", "--layout", "--depth-unit", "--unit", "--every", "--poses",
             "--backend", "--keep", "--start", "--goal", "--contact", "--since", "--tag-size"),
            Tool("Turn a capture or scan into a metric, level MuJoCo scene; minutes. Read the verdict first.",
                 "frames", "out", ("robot", "max_frames", "seed", "overwrite")),
        ),
        "inspect": (
            "how a capture is recognised, and what is wrong with it", "realsim inspect my_capture", "recon", (),
            Tool("Say what a capture folder or scan is taken for, every convention assumed, and what is wrong with it.",
                 "frames"),
        ),
        "contact": (
            "collision geometry for any mesh, chosen by measured error and cost",
            "realsim contact stairs.stl --unit mm --out stairs", "recon",
            ("--out", "--unit", "--up", "--ground-z", "--robot", "--overwrite", "--strict", "--contact"),
            Tool("Give a mesh file collision geometry for MuJoCo, chosen by measured error; a minute. Read the verdict "
                 "first.", "meshes", "out", ("unit", "up", "ground_z", "overwrite")),
        ),
        "lint": ("what an MJCF of your own collides as: hulls, phantoms, what is missing, seams",
                 "realsim lint terrain.xml", "recon"),
        "export": (
            "a scene in other formats: USD, URDF, SDF, GLB, height map, ...", "realsim export scene --to usd,urdf", "",
            (), Tool("Write a scene in the formats of other tools.", "scenes", "out", ("to", "overwrite")),
        ),
        "view": ("look at a scene in the browser, live", "realsim view scene", "viewer"),
        "record": ("frames of a RealSense camera into a folder", "realsim record my_capture --seconds 30", "realsense"),
        "model": ("check a feed-forward model in an ONNX file", "realsim model inspect model.onnx", "recon"),
    },
    "Robots and their logs": {
        "log": ("contents of a robot's recording (MCAP, bags, LeRobot, CSV, ...), and a case made from it",
                "realsim log walk.mcap --model robot.xml --out case"),
        "diagnose": (
            "a robot's logs and its model -> where the sim-to-real gap lies, what causes it, how much",
            "realsim diagnose my_case --out diagnosis", "",
            ("--out", "--model", "--policy", "--scene", "--since", "--check", "--init", "--effects", "--overwrite",
             "--strict"),
            Tool("Say where a robot's logs differ from its simulator and what causes it; minutes, up to ten for a "
                 "humanoid. With `check`, only say within seconds whether the log can be used and what is odd about "
                 "it.", "cases", "out", ("check", "max_causes", "overwrite"),
                 ("schema", "runs", "health.warnings", "verdict", "sentence", "causes", "equivalent", "where",
                  "shrinkage", "unexplained_share", "next_experiment", "seconds")),
            {"policy": ("network",)},
        ),
        "excite": ("the recording that tells apart what a diagnosis could not: command files within the robot's limits",
                   "realsim excite diagnosis --out experiment"),
        "doctor": ("a robot's log and its policy -> contract, delay, physics, camera and terrain on one page",
                   "realsim doctor my_case --policy policy.onnx --out doctor", "", (), None, {"policy": ("network",)}),
        "footholds": (
            "a robot's log against the scene it walked on -> which foothold differs from the scan, by how much",
            "realsim footholds my_case --scene scene --out footholds",
        ),
    },
    "Machines": {
        "mcp": ("realsim as tools for agents (Model Context Protocol)", "realsim mcp --root ~/captures ~/scenes",
                "mcp"),
        "schema": ("what a command prints with --json, as a JSON Schema", "realsim schema reconstruct"),
    },
    "To try": {
        "app": ("the commands as a page in the browser, on this machine", "realsim app my_folder", "app"),
        "demo": ("render, reconstruct and measure, end to end", "realsim demo --out demo_out", "recon"),
        "synth": ("render a synthetic capture with its truth", "realsim synth --terrain boxes --out synthetic",
                  "recon"),
    },
}  # fmt: skip
"""Group -> name -> summary, example, extra, common, tool, takes: fields of `Command`."""
COMMANDS: dict[str, Command] = {
    name: Command(f"realsim.cli.commands.{name}:{name}", summary, example, group, *more)
    for group, known in _OWN.items()
    for name, (summary, example, *more) in known.items()
}


def commands() -> dict[str, Command]:
    """Name -> command: those above, and those that installed packages add (entry points `realsim.commands`).

    A package declares what it adds in a dictionary `COMMANDS` of the package that the functions' modules are in, or of
    a module of its own; that is all of it that is imported here. A function without a declaration is a command too.
    """
    added = {point.name: point.value for point in entry_points(group="realsim.commands")}
    for value in list(added.values()):  # an installation may be older than the checkout that it points to
        for name in _declarations(value):
            added.setdefault(name, f"{_package(value)}.{name}:{name}")
    declared = {name: _declared(name, value) for name, value in added.items() if name not in COMMANDS}
    # In the order in which a package declares them.
    order = [name for value in added.values() for name in _declarations(value) if name in declared]
    return COMMANDS | {name: declared[name] for name in dict.fromkeys([*order, *declared])}


def find(name: str) -> Command:
    """The command of a name. Raises UnknownNameError with the closest ones."""
    known = COMMANDS if name in COMMANDS else commands()  # to ask what is installed takes longer than many a command
    if name not in known:
        raise UnknownNameError("command", name, known)
    return known[name]


def _declared(name: str, function: str) -> Command:
    """The declaration of a function that an entry point names."""
    command = _declarations(function).get(name)
    if command is not None:
        return replace(command, function=function)
    return Command(
        function,
        f"of the package {_package(function)}",
        f"realsim {name} --help",
        function.partition(".")[0].partition(":")[0],
    )


@cache
def _declarations(function: str) -> Mapping[str, Command]:
    try:
        found: Mapping[str, Command] = getattr(import_module(_package(function)), "COMMANDS", {})
    except Exception:  # whatever another package raises: its command says so when it is called, the others go on
        return {}
    return found


def _package(function: str) -> str:
    """Where the command of an entry point is declared."""
    module = function.partition(":")[0]
    return module.rpartition(".")[0] or module
