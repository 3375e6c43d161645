"""The task from a file: only what differs from the paper's defaults need be written down."""

from pathlib import Path

from realsim.core.files import read_json
from trainer.fields import filled
from trainer.tasks.parkour import ParkourConfig


def load_task(path: Path | None) -> ParkourConfig:
    """A task with the values of a JSON file, such as {"command": {"speed": [0.5, 0.8]}, "depth": {"use": false}}.

    Raises:
        TrainerError: a field that does not exist, or a value of another kind than the default.
    """
    return (
        ParkourConfig() if path is None else filled(ParkourConfig, read_json(path), "task field", path, ParkourConfig())
    )
