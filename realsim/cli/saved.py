"""Options from a file or a preset: `--config report.json`, `--preset stairs`. What is typed as well wins."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from realsim.core.errors import RealsimError, UnknownNameError, did_you_mean
from realsim.core.files import read_json
from realsim.core.recognise import whole

T = TypeVar("T")
PRESETS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    # A phone's LiDAR reaches 5 m, and its scale is known to 4 percent.
    "phone": {"capture": {"max_depth": 5.0}, "scale": {"sensor_sigma": 0.04}},
    # A robot needs room to stand before the first step.
    "stairs": {"align": {"margin": 1.0}, "scene": {"robot": "g1"}},
    # Walls and ceiling belong to it.
    "room": {"align": {"keep": "all"}},
    # From a start platform over obstacles to a goal, as in the paper.
    "parkour": {"align": {"keep": "terrain", "margin": 0.5}, "scene": {"robot": "g1", "contact": "auto"}},
}
"""Name -> differences from the defaults of `realsim reconstruct`."""
NEVER = ("overwrite", "resume")
"""What is never taken from a file: it is about that result, not about how it was made."""


def defaults_of(function: Callable[..., Any], file: str | None, preset: str | None) -> dict[str, Any]:
    """Parameter -> value in place of a command's own defaults.

    Args:
        function: the command.
        file: JSON that a command wrote (its `config`), or a configuration alone.
        preset: a name of PRESETS.

    Raises:
        RealsimError: the command has no configuration, or the file none that fits.
    """
    kind = get_type_hints(function).get("config") if "config" in inspect.signature(function).parameters else None
    if kind is None:
        raise RealsimError("this command takes no --config or --preset", expected="options that are typed")
    config = kind()
    if preset is not None:
        if preset not in PRESETS:
            raise UnknownNameError("preset", preset, PRESETS)
        part = _section(PRESETS[preset], kind)
        if not part:
            raise RealsimError(f"the preset {preset} says nothing to this command", expected="realsim reconstruct")
        config = updated(config, part, None)
    if file is not None:
        path = Path(file)
        path = path / "report.json" if path.is_dir() else path
        whole_file = read_json(path)
        data = whole_file.get("config", whole_file) if isinstance(whole_file, dict) else None
        if not isinstance(data, dict) or not data:
            raise RealsimError(
                "no configuration in the file",
                file=path,
                expected="report.json of realsim reconstruct, or an object of options",
                found=type(whole_file).__name__,
                hint=f"realsim reconstruct FRAMES --out scene writes one: {whole(path)}",
            )
        config = updated(config, _section(data, kind), path)
    return {"config": config}


def _section(data: Mapping[str, Any], kind: type) -> Mapping[str, Any]:
    """The part of a configuration of `realsim reconstruct` that belongs to a stage, or all of it."""
    from realsim.pipeline import ReconstructConfig

    stages = {name: part for name, part in get_type_hints(ReconstructConfig).items() if is_dataclass(part)}
    name = next((name for name, part in stages.items() if part is kind), None)
    if name is not None and set(data) & set(stages):
        part: Mapping[str, Any] = data.get(name, {})
        return part
    return data


def updated(config: T, data: Mapping[str, Any], file: Path | None, where: str = "") -> T:
    """A configuration with the values of nested dictionaries, as JSON has them.

    Raises:
        RealsimError: a name that it does not have, or a value of another kind; the path of it is named.
    """
    hints = get_type_hints(type(config))
    known = [f.name for f in fields(config)]  # type: ignore[arg-type]
    inner = {
        f.name: part for part in known if is_dataclass(getattr(config, part)) for f in fields(getattr(config, part))
    }
    new: dict[str, Any] = {}
    for name, value in data.items():
        path = f"{where}.{name}" if where else str(name)
        if name not in known:
            raise RealsimError(
                f"unknown option {path}",
                file=file,
                expected=f"some of {', '.join(known)}",
                hint=f'write {{"{inner[name]}": {{"{name}": ...}}}}'
                if name in inner
                else did_you_mean(str(name), [*known, *inner]) or f"remove {path}",
            )
        if name in NEVER:
            continue
        before = getattr(config, name)
        if is_dataclass(before) and isinstance(value, Mapping):
            new[name] = updated(before, value, file, path)
            continue
        try:
            new[name] = _value(value, hints[name])
        except (TypeError, ValueError) as error:
            raise RealsimError(
                f"{path} has another kind of value", file=file, expected=str(error), found=repr(value)[:80]
            ) from error
    try:
        return replace(config, **new)  # type: ignore[type-var]
    except ValueError as error:
        raise RealsimError(f"the options do not fit: {error}", file=file, expected="values as typed ones") from error


def _value(value: Any, hint: Any) -> Any:
    """A value of JSON as one of a type; ValueError says what was expected."""
    if get_origin(hint) in (Union, UnionType):
        for option in get_args(hint):
            try:
                return _value(value, option)
            except ValueError:
                continue
    elif hint in (None, NoneType):
        if value is None:
            return None
    elif get_origin(hint) is Literal:
        if value in get_args(hint):
            return value
    elif hint is Path:
        if isinstance(value, str):
            return Path(value)
    elif hint is float:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
    elif get_origin(hint) is tuple:
        parts = get_args(hint)
        if isinstance(value, list) and (parts[-1] is Ellipsis or len(parts) == len(value)):
            kinds = [parts[0]] * len(value) if parts[-1] is Ellipsis else parts
            return tuple(_value(v, kind) for v, kind in zip(value, kinds, strict=True))
    elif isinstance(hint, type) and isinstance(value, hint) and isinstance(value, bool) == (hint is bool):
        return value
    raise ValueError(getattr(hint, "__name__", str(hint)))
