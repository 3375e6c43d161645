"""What a command needs, in the help and in the message where it is missing."""

from pathlib import Path

import pytest

import trainer.commands
from realsim.core.errors import MissingExtraError
from realsim.core.recognise import explain_inputs
from tests.gap.truth import ARM


def test_commands_that_import_torch_say_so() -> None:
    for name, command in trainer.commands.COMMANDS.items():
        source = Path(trainer.commands.__file__).with_name(f"{name}.py").read_text("utf-8")
        if "from trainer.commands import common" in source:
            assert command.extra == "train", name


def test_a_missing_package_comes_before_what_was_given(tmp_path: Path) -> None:
    def finetune(scene: Path) -> None:
        raise MissingExtraError("torch", "train", "training")

    (tmp_path / "robot.xml").write_text(ARM)
    with pytest.raises(MissingExtraError) as error:
        explain_inputs(finetune)(tmp_path / "robot.xml")
    assert error.value.hint == 'pip install "realsim[train]"'
