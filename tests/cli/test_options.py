"""What is relied on of tyro, outside of its stable interface: the parser that it makes, and its events of errors."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
import tyro

from realsim.cli.command_line import main
from realsim.cli.options import UsageError, options_of, parse


@dataclass(frozen=True)
class Inner:
    depth_limit: float = 6.0
    """Metres."""

    def __post_init__(self) -> None:
        if self.depth_limit <= 0:
            raise ValueError("depth_limit must be positive")


@dataclass(frozen=True)
class Config:
    inner: Inner
    seed: int = 0
    """Of everything random."""


def command(
    source: Annotated[Path, tyro.conf.Positional],
    config: Config,
    size: tuple[float, float] = (1.0, 2.0),
    unit: Literal["m", "mm"] | None = None,
    overwrite: bool = False,
    report: bool = True,
) -> tuple[object, ...]:
    """What it does.

    Args:
        source: to read.
        size: metres.
        unit: of the file.
        overwrite: replace.
        report: write it.
    """
    return source, config, size, unit, overwrite, report


def test_options_are_those_of_the_function() -> None:
    description, options = options_of(command)
    assert description.strip() == "What it does."
    found = {option.names: (option.value, option.help, option.group) for option in options}
    assert found == {
        (): ("PATH", "to read.", ""),
        ("--size",): ("FLOAT FLOAT", "metres. (default: 1.0 2.0)", ""),
        ("--unit",): ("{m,mm}", "of the file.", ""),
        ("--overwrite",): ("", "replace.", ""),
        ("--report", "--no-report"): ("", "write it. (default: True)", ""),
        ("--seed",): ("INT", "Of everything random. (default: 0)", "general"),
        ("--depth-limit",): ("FLOAT", "Metres. (default: 6.0)", "inner"),
    }


def test_arguments_become_a_call() -> None:
    call = parse(command, "x", ["a", "--size", "3", "4", "--seed=7", "--no-report", "--depth_limit", "2"])
    assert call() == (Path("a"), Config(Inner(2.0), 7), (3.0, 4.0), None, False, False)


def test_defaults_may_be_other_ones() -> None:
    call = parse(command, "x", ["a", "--seed", "8"], {"config": Config(Inner(3.0), 7), "unit": "mm"})
    assert call() == (Path("a"), Config(Inner(3.0), 8), (1.0, 2.0), "mm", False, True)


def test_an_option_of_several_values_may_be_given_several_times() -> None:
    def several(source: Annotated[Path, tyro.conf.Positional], use: tuple[str, ...] = (), seed: int = 0) -> object:
        return source, use, seed

    for arguments in ("a --use x --seed 2 --use y z", "a --seed 1 --use x y --use z --seed 2"):
        assert parse(several, "x", arguments.split())() == (Path("a"), ("x", "y", "z"), 2)


@pytest.mark.parametrize(
    ("arguments", "message", "found"),
    [
        ([], "SOURCE is missing", None),
        (["a", "--sead", "1"], "unknown option --sead", "--sead 1"),
        (["a", "b"], "too many arguments", "b"),
        (["a", "--unit", "cm"], "--unit does not take 'cm'", "cm"),
        (["a", "--size", "1"], "--size lacks a value", "--size 1"),
        (["a", "--seed", "q"], "--seed cannot take this value", "--seed q"),
        (["a", "--seed=1.5"], "--seed cannot take this value", "--seed 1.5"),
        (["a", "--depth-limit", "-1"], "--depth-limit must be positive", None),
    ],
)
def test_what_does_not_fit_is_an_error_in_our_words(arguments: list[str], message: str, found: str | None) -> None:
    with pytest.raises(UsageError) as caught:
        parse(command, "x", arguments)
    assert caught.value.message == message
    assert caught.value.found == found
    assert "realsim help x" in str(caught.value.hint) or "did you mean" in str(caught.value.hint)


def test_errors_have_one_style(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["inspect"], ["inspect", "a", "--nope"], ["contact", "a", "--up", "q"], ["inspect", "/none"]):
        assert main(arguments) == 2
        lines = capsys.readouterr().err.splitlines()
        assert lines[0].startswith("error: ")
        assert all(line.split(":")[0] in ("  file", "  expected", "  found", "  do") for line in lines[1:])
        assert main([*arguments, "--json"]) == 2
        assert json.loads(capsys.readouterr().out)["hint"]


@pytest.mark.parametrize("redirect", [">&-", "2>&-", ">&- 2>&-", "<&-", "2>/dev/full"])
def test_streams_that_are_closed_or_full(redirect: str, tmp_path: Path) -> None:
    line = f"{sys.executable} -m realsim inspect {tmp_path} {redirect}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr + done.stdout


def test_an_output_that_cannot_be_written_is_an_error() -> None:
    line = f"{sys.executable} -m realsim schema > /dev/full"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: cannot write to standard output")
    assert "Traceback" not in done.stderr


def test_completion_offers_commands_and_their_options() -> None:
    script = subprocess.run(
        [sys.executable, "-m", "realsim", "--completion", "bash"], capture_output=True, text=True, check=True
    ).stdout

    def offered(*words: str) -> list[str]:
        line = f"""{script}
COMP_WORDS=({" ".join(f"'{w}'" for w in words)}); COMP_CWORD={len(words) - 1}; _realsim; echo "${{COMPREPLY[@]}}" """
        return subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True).stdout.split()

    assert offered("realsim", "rec") == ["reconstruct", "record"]
    assert offered("realsim", "help", "insp") == ["inspect"]
    assert offered("realsim", "contact", "--grou") == ["--ground-z"]
    assert {"--out", "--check", "--json"} <= set(offered("realsim", "diagnose", "--"))


def test_an_unknown_shell_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--completion", "tcsh"]) == 2
    assert "one of bash, fish, zsh" in capsys.readouterr().err
