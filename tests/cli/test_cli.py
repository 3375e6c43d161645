"""The command line: help, exit codes, errors for people and for machines."""

import json
import os
import re
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from realsim.cli.command_line import main
from realsim.cli.commands import other_arguments, set_arguments
from realsim.cli.options import options_of
from realsim.cli.table import COMMANDS, commands


def test_every_command_has_a_summary_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for name, command in COMMANDS.items():
        line = next(line for line in text.splitlines() if line.startswith(f"  {name} "))
        assert command.summary in line
        assert line.endswith(f"[{command.extra}]") == bool(command.extra)
        assert text.index(command.group) < text.index(line)
        assert main([name, "--help"]) == 0
        assert f"realsim {name}" in capsys.readouterr().out


def test_help_ends_with_an_example_and_knows_no_names_of_the_source(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    for name in commands():
        assert main(["help", name]) == 0
        text = capsys.readouterr().out
        assert f"example: realsim {name} " in text
        assert "--quiet" in text
        assert not re.search(r"config[.]\w*|default: None|required", text.replace("--config", "")), name


def test_help_waits_for_no_heavy_package() -> None:
    """Help is there at once: what takes its time to import is imported by what uses it."""
    heavy = ("torch", "scipy", "mujoco", "open3d", "cv2", "trimesh", "onnxruntime", "ray", "submitit", "mcp", "pyarrow")
    code = f"""
import contextlib, io, sys
from realsim.cli.command_line import main
from realsim.cli.table import commands
for name in commands():
    with contextlib.redirect_stdout(io.StringIO()):
        assert main([name, "--help"]) == 0
    print(name, [package for package in {heavy!r} if package in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == len(commands())
    assert [line for line in lines if not line.endswith("[]")] == []


def test_help_lists_the_choices_there_are() -> None:
    from realsim.align import SEGMENTERS
    from realsim.capture import LAYOUTS
    from realsim.export import CONTACT, EXPORTERS
    from realsim.feedforward import BACKENDS
    from realsim.jobs import EXECUTORS
    from realsim.meshing import METHODS
    from realsim.robots import ROBOTS as OWN_ROBOTS
    from realsim.scale import ESTIMATORS
    from realsim.synth import PLACES, TERRAINS
    from trainer.physics import ENGINES
    from trainer.ppo.strategies import STRATEGIES
    from trainer.robots import ROBOTS
    from trainer.trainers import BUILT_IN

    choices = {
        "reconstruct": {
            "layout": ["auto", *LAYOUTS],
            "contact": ["auto", *CONTACT],
            "segmenter": SEGMENTERS,
            "backend": BACKENDS,
            "mesh-method": METHODS,
            "scale-method": ESTIMATORS,
        },
        "synth": {"terrain": [*TERRAINS, *PLACES]},
        "demo": {"terrain": TERRAINS, "robot": [*OWN_ROBOTS, "menagerie:NAME"]},
        "export": {"to": EXPORTERS},
        "finetune": {"strategy": STRATEGIES, "engine": ENGINES, "trainer": BUILT_IN, "robot": [*ROBOTS, "FILE.toml"]},
        "evaluate": {"engine": ENGINES},
        "contact": {"executor": EXECUTORS},
    }
    for command, options in choices.items():
        values = {name: option.value for option in options_of(commands()[command].load())[1] for name in option.names}
        for option, names in options.items():
            assert sorted(values[f"--{option}"].strip("{}").removeprefix("all|").split(",")) == sorted(names)


def test_a_flag_takes_the_same_kind_of_value_everywhere() -> None:
    pytest.importorskip("torch")
    kinds: dict[str, dict[str, str]] = {}
    for name, command in commands().items():
        for option in options_of(command.load())[1]:
            if option.names:
                # Which choices there are may differ; a text, a number, a file or a switch it is everywhere.
                kinds.setdefault(option.names[0], {})[name] = "STR" if "{" in option.value else option.value
    assert {flag: by for flag, by in kinds.items() if len(set(by.values())) > 1} == {}


def test_the_help_says_what_an_option_takes_that_may_be_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "reconstruct"]) == 0
    text = capsys.readouterr().out
    assert "--start FLOAT FLOAT  " in text
    assert "--depth-unit FLOAT  " in text


def test_a_long_help_shows_what_is_used_most(capsys: pytest.CaptureFixture[str]) -> None:
    """The options that are named exist, each is described as in the full help, and it fits on a screen."""
    for name, command in commands().items():
        if not command.common:
            continue
        assert main([name, "--help"]) == 0
        shown = capsys.readouterr().out
        assert main(["help", name]) == 0
        full = capsys.readouterr().out
        assert re.findall(r"^  (--[a-z-]+)", shown, re.M) == list(command.common)
        assert f"realsim help {name}" in shown
        assert "example: " in shown
        assert len(shown.splitlines()) < min(66, len(full.splitlines()))
        assert {line for line in shown.splitlines() if line.startswith("  ")} <= set(full.splitlines())


def test_help_that_nobody_reads_to_its_end_is_no_error() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-c", "from realsim.cli.command_line import main; main(['inspect', '--help'])"],
        stdout=writer, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    os.close(writer)
    assert done.returncode == 0
    assert done.stderr == ""


def test_switches_that_are_on_are_named_as_what_they_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "diagnose"]) == 0
    assert "--report, --no-report" in capsys.readouterr().out


def test_every_option_that_is_spoken_of_exists() -> None:
    """In messages, docstrings and docs: what they tell people to type must be taken."""
    pytest.importorskip("torch")
    others = {"--head", "--mjcf"}  # of ray and MuJoCo's viewer
    others |= {"--opset", "--tolerance", "--course"}  # of tools/export_onnx and benchmarks/training, by tyro
    others |= {"--logdir", "--nproc-per-node", "--nnodes", "--rdzv-endpoint"}  # of tensorboard and torchrun
    others |= {"--upgrade", "--env", "--csv"}  # of pip, of GNU parallel and of ros2 topic echo
    known = {name for c in commands().values() for option in options_of(c.load())[1] for name in option.names}
    known = {name.rstrip("0123456789") for name in known}
    known |= {"--help", "--json", "--quiet", "--version", "--completion", "--config", "--preset"}
    root = Path(__file__).resolve().parents[2]
    for script in [*root.glob("benchmarks/**/*.py"), *root.glob("tools/**/*.py")]:
        known |= set(re.findall(r'"(--[a-z-]+)"', script.read_text(encoding="utf-8")))
    texts = [*root.glob("realsim/**/*.py"), *root.glob("trainer/**/*.py"), *root.glob("docs/*.md"), root / "README.md"]
    wrong = [
        f"{path.relative_to(root)}: {option}"
        for path in texts
        # "(" comes before CSS variables.
        for option in re.findall(r"(?<![\w(-])--[a-z][a-z.-]+[a-z]", path.read_text(encoding="utf-8"))
        if option not in known | others
    ]
    assert wrong == []


def test_unknown_command_names_the_closest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reconstuct"]) == 2
    assert "did you mean reconstruct" in capsys.readouterr().err


def test_missing_folder_is_exit_code_2_without_a_traceback(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reconstruct", str(tmp_path / "none"), "--out", str(tmp_path / "scene")]) == 2
    error = capsys.readouterr().err
    assert "none" in error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_is_a_file_is_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("x")
    assert main(["demo", "--out", str(tmp_path / "taken"), "--json"]) == 2
    assert "output is a file" in json.loads(capsys.readouterr().out)["message"]


def test_errors_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["inspect", str(tmp_path / "none")], []):
        assert main([*arguments, "--json"]) == 2
        said = json.loads(capsys.readouterr().out)
        assert said["error"].endswith("Error")
        assert said["message"]
    assert main(["--version", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["version"]


def test_values_that_do_not_fit_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(tmp_path), "--min-depth", "7"]) == 2
    assert "need 0 <= --min-depth < --max-depth" in capsys.readouterr().err


def test_points_that_are_no_numbers_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for point in (["nan", "0"], ["1", "inf"]):
        assert main(["reconstruct", str(tmp_path), "--start", *point, "--out", str(tmp_path / "out")]) == 2
        assert "start must be two numbers in metres" in capsys.readouterr().err


def test_an_unknown_name_is_said_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--robot", "nope", "--out", str(tmp_path / "demo")]) == 2
    assert "unknown robot 'nope'" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()
    assert main(["synth", "--terrain", "coridor", "--out", str(tmp_path / "synth")]) == 2
    assert "did you mean corridor" in capsys.readouterr().err


def test_arguments_of_an_item_are_the_commands_less_its_own() -> None:
    set_arguments(["a", "--out", "x", "--jobs=2", "--seed", "3", "b", "--robot", "g1"])
    assert other_arguments({"--out": 1, "--jobs": 1}, ["a", "b"]) == ("--seed", "3", "--robot", "g1")


def test_inputs_as_a_shell_completes_them_are_no_options() -> None:
    set_arguments(["caps/a/", "./caps/b", "--out", "x", "--cache", "kept/"])
    rest = other_arguments({"--out": 1}, [str(Path("caps/a/")), str(Path("./caps/b"))])
    assert rest == ("--cache", "kept/")


def test_packages_add_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A lone module as well as a module of a package, a function without a declaration, and ones that are broken."""
    declared = 'COMMANDS = {"NAME": Command("", "what NAME does", "realsim NAME", "Of my own")}'
    source = f"""
from realsim.cli.command import Command
from realsim.cli.commands import CommandResult
{declared}
def run(times: int = 2) -> CommandResult:
    return CommandResult("NAME " * times)
"""
    (tmp_path / "pack").mkdir()
    (tmp_path / "lone.py").write_text(source.replace("NAME", "alone"))
    (tmp_path / "pack" / "__init__.py").write_text(
        "from realsim.cli.command import Command\n" + declared.replace("NAME", "packed")
    )
    newer = '\nCOMMANDS["newer"] = Command("", "since the installation", "realsim newer", "Of my own")\n'
    with (tmp_path / "pack" / "__init__.py").open("a") as file:
        file.write(newer)
    (tmp_path / "pack" / "inner.py").write_text(source.replace("NAME", "packed"))
    (tmp_path / "pack" / "newer.py").write_text(source.replace("NAME", "newer").replace("run(", "newer("))
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "damaged.py").write_text("1 / 0")
    (tmp_path / "odd.py").write_text("def run() -> dict:\n    return {}\n")
    named = {
        "alone": "lone:run",
        "packed": "pack.inner:run",
        "bare": "lone:run",
        "broken": "damaged:run",
        "odd": "odd:run",
    }
    points = [EntryPoint(name, value, "realsim.commands") for name, value in named.items()]
    monkeypatch.setattr("realsim.cli.table.entry_points", lambda group: points)
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert "Of my own" in said
    for name, text in (("broken", "ZeroDivisionError"), ("odd", "CommandResult")):
        assert main([name]) == 2
        assert text in capsys.readouterr().err
    assert main(["bare"]) == 0
    assert capsys.readouterr().out.split() == ["alone"] * 2
    assert "since the installation" in said  # entry points of an installation older than its checkout
    assert main(["newer"]) == 0
    assert capsys.readouterr().out.split() == ["newer"] * 2
    for name in ("alone", "packed"):
        assert f"what {name} does" in said
        assert main([name, "--times", "3"]) == 0
        assert capsys.readouterr().out.split() == [name] * 3


@pytest.mark.parametrize(
    "command",
    [
        "reconstruct my --out my",
        "reconstruct my/capture --out my",
        "contact my/a.stl --out my",
        "diagnose my/capture --out my",
    ],
)
def test_the_input_is_never_overwritten(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my" / "capture").mkdir(parents=True)
    for name in ("a.stl", "report.json"):
        (tmp_path / "my" / name).write_text("precious")
    assert main([*command.split(), "--overwrite", "--json"]) == 2
    assert "input lies in the output" in json.loads(capsys.readouterr().out)["message"]
    assert (tmp_path / "my" / "a.stl").read_text() == "precious"
