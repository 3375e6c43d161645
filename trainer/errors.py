"""Errors of training that tell a person what to do."""

from collections.abc import Mapping
from math import isfinite
from operator import ge, gt, le
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
    for word, limits, fits in (("above", above, gt), ("at least", least, ge), ("at most", most, le)):
        for name, limit in (limits or {}).items():
            value = getattr(config, name)
            for number in value if isinstance(value, tuple) else () if value is None else (value,):
                if not (fits(number, limit) and isfinite(number)):
                    found = f"{name} {number:g} ({type(config).__name__})"
                    raise TrainerError(f"{name} must be {word} {limit:g}", found=found)
