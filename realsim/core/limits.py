"""Limits of the numbers in a configuration."""

from collections.abc import Iterator, Mapping
from math import isfinite
from operator import ge, gt, le
from typing import Any


def beyond_limits(
    config: Any,
    above: Mapping[str, float] | None = None,
    least: Mapping[str, float] | None = None,
    most: Mapping[str, float] | None = None,
) -> Iterator[tuple[str, float]]:
    """(what its limit is, the value) of each number that is not finite, or beyond the limit of its field.

    Args:
        above, least, most: field -> what each of its numbers must be above, at least, at most. None has no number.
    """
    for word, limits, fits in (("above", above, gt), ("at least", least, ge), ("at most", most, le)):
        for name, limit in (limits or {}).items():
            value = getattr(config, name)
            for number in value if isinstance(value, tuple) else () if value is None else (value,):
                if not (fits(number, limit) and isfinite(number)):
                    yield f"{name} must be {word} {limit:g}", number


def check_limits(config: Any, **limits: Mapping[str, float]) -> None:
    """Refuse a configuration with such a number; for `limits` see `beyond_limits`.

    Raises:
        ValueError: it names the field, the limit and the value.
    """
    for limit, found in beyond_limits(config, **limits):
        raise ValueError(f"{limit}, found {found:g}")
