"""Errors of training that tell a person what to do."""

from collections.abc import Mapping
from math import isfinite
from typing import Any

from realsim.core.errors import RealsimError


class TrainerError(RealsimError):
    """A scene, policy, checkpoint or machine that training cannot work with."""

    usual_hint = "docs/training.md says what training needs; realsim help finetune lists its options"


def check_fields(
    config: Any,
    *,
    above: Mapping[str, float] | None = None,
    least: Mapping[str, float] | None = None,
    most: Mapping[str, float] | None = None,
) -> None:
    """Refuse a configuration with a number that is not finite, or beyond the limit of its field.

    Args:
        above, least, most: field -> what each of its numbers must be above, at least, at most. None has no number.

    Raises:
        TrainerError: it names the field, the limit and the value.
    """
    for word, limits in (("above", above), ("at least", least), ("at most", most)):
        for name, limit in (limits or {}).items():
            value = getattr(config, name)
            for number in value if isinstance(value, tuple) else () if value is None else (value,):
                beyond = (
                    number <= limit if word == "above" else number < limit if word == "at least" else number > limit
                )
                if beyond or not isfinite(number):
                    message = f"{name} must be {word} {limit:g}"
                    raise TrainerError(message, expected=f"a number {word} {limit:g}", found=f"{name} {number:g}")
