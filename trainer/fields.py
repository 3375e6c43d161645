"""Dataclasses out of what anybody may have written: JSON, TOML, the header of a checkpoint."""

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from realsim.core.errors import did_you_mean
from trainer.errors import TrainerError

T = TypeVar("T")
_KINDS = {bool: "true or false", int: "a whole number", float: "a finite number", str: "a text", NoneType: "null"}


def filled(kind: type[T], data: Any, what: str, file: Path, start: T | None = None, where: str = "") -> T:
    """A dataclass by the annotations of its fields, and so the dataclasses in it.

    Args:
        data: as parsed; a list stands for a tuple.
        what: what a field is of, for the message.
        start: has what `data` leaves out, and one number may stand for a whole tuple of it; if None, defaults of the
            fields do, and a field without one must be there.
        where: path of the whole in the file, for the message.

    Raises:
        TrainerError: a field that is unknown, missing, or of another kind; it is named with its path.
    """
    known = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
    if not isinstance(data, Mapping):
        message = f"{where.rstrip('.') or 'the file'} must be an object: {what}"
        raise TrainerError(message, file=file, expected=", ".join(known), found=brief(data))
    for name in data:
        if name not in known:
            hint = did_you_mean(str(name), known)
            message = f"unknown {what} {where}{brief(name)}"
            raise TrainerError(message, file=file, expected=f"one of {', '.join(known)}", found=brief(name), hint=hint)
    required = {n for n, f in known.items() if f.default is MISSING and f.default_factory is MISSING}
    if start is None and (missing := required - {*data}):
        message = f"the {what} {where}{sorted(missing)[0]} is missing"
        raise TrainerError(message, file=file, expected=", ".join(sorted(missing)), found=", ".join(data))
    hints = get_type_hints(kind)
    given = {n: _value(hints[n], v, what, file, getattr(start, n, None), where + n) for n, v in data.items()}
    try:
        return kind(**({n: getattr(start, n) for n in known} | given if start is not None else given))
    except TrainerError as error:  # a value beyond the limits of its field
        error.file = error.file or str(file)
        raise


def _value(hint: Any, value: Any, what: str, file: Path, start: Any, where: str) -> Any:
    if is_dataclass(hint):
        return filled(hint, value, what, file, start, f"{where}.")  # type: ignore[arg-type]
    origin, parts = get_origin(hint), get_args(hint)
    if origin is UnionType:
        hint = next(p for p in parts if p is not NoneType)
        return None if value is None else _value(hint, value, what, file, start, where)
    if origin is Literal and value in parts:
        return value
    if origin is dict and isinstance(value, Mapping):
        return {str(k): _value(parts[1], v, what, file, None, f"{where}.{k}") for k, v in value.items()}
    if origin is tuple:
        if isinstance(start, tuple) and not isinstance(value, list):
            value = [value] * len(start)
        each = parts[:1] * len(value) if parts[-1] is ... and isinstance(value, list | tuple) else parts
        if isinstance(value, list | tuple) and len(value) == len(each):
            return tuple(_value(p, v, what, file, None, where) for p, v in zip(each, value, strict=True))
        expected = "a list" if parts[-1] is ... else f"a list of {len(parts)}"
    else:
        number = (
            isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300 and isfinite(value)
        )
        if hint is Any or (hint in (int, float) and number and hint(value) == value):
            return value if hint is Any else hint(value)
        if hint in (str, bool) and isinstance(value, hint):
            return value
        expected = f"one of {parts}" if origin is Literal else _KINDS.get(hint, "an object")
    raise TrainerError(f"{where} has a value of the wrong kind", file=file, expected=expected, found=brief(value))


def brief(value: Any) -> str:
    """As text, cut after 120 characters."""
    text = str(value) if isinstance(value, str | BaseException) else repr(value)
    return text if len(text) <= 120 else text[:120] + "..."
