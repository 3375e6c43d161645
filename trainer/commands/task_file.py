"""The task from a file: only what differs from the paper's defaults need be written down."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from realsim.core.errors import UnknownNameError
from realsim.core.files import read_json
from trainer.errors import TrainerError
from trainer.tasks.parkour import ParkourConfig


def load_task(path: Path | None) -> ParkourConfig:
    """A task with the values of a JSON file, such as {"command": {"speed": [0.5, 0.8]}, "depth": {"use": false}}.

    Raises:
        UnknownNameError: a field that does not exist; the message lists those that do.
        TrainerError: a value of another kind than the default.
    """
    return ParkourConfig() if path is None else _filled(ParkourConfig(), read_json(path), path, "")


def _filled(config: Any, values: Any, path: Path, where: str) -> Any:
    if not isinstance(values, dict):
        raise TrainerError(f"{where or 'the file'} must be an object", file=path, found=type(values).__name__)
    known = {f.name for f in fields(config)}
    changed = {}
    for name, value in values.items():
        if name not in known:
            raise UnknownNameError(f"task field {where}", name, known, file=path)
        old = getattr(config, name)
        changed[name] = (
            _filled(old, value, path, f"{where}{name}.") if is_dataclass(old) else _like(old, value, path, where + name)
        )
    return replace(config, **changed)


def _like(old: Any, value: Any, path: Path, where: str) -> Any:
    """The value in the default's type; a number may stand for a range."""
    if isinstance(old, tuple):
        items = value if isinstance(value, list) else [value] * len(old)
        if len(items) == len(old):
            return tuple(_like(a, b, path, where) for a, b in zip(old, items, strict=True))
    elif isinstance(old, bool) or old is None or isinstance(old, str):
        if old is None or isinstance(value, type(old)):
            return value
    elif isinstance(value, int | float) and not isinstance(value, bool):
        return type(old)(value)
    elif isinstance(old, dict) and isinstance(value, dict):
        return {**old, **value}
    raise TrainerError(f"{where} has a value of the wrong kind", file=path, expected=f"like {old!r}", found=repr(value))
