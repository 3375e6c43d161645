"""Errors of training that tell a person what to do."""

from collections.abc import Mapping
from typing import Any

from realsim.core.errors import RealsimError
from realsim.core.limits import beyond_limits


class TrainerError(RealsimError):
    """A scene, policy, checkpoint or machine that training cannot work with."""

    usual_hint = "docs/training.md says what training needs; realsim help finetune lists its options"


def check_fields(config: Any, **limits: Mapping[str, float]) -> None:
    """Refuse a configuration with a number beyond the limit of its field; for `limits` see `beyond_limits`.

    Raises:
        TrainerError: it names the field, the limit and the value.
    """
    for limit, found in beyond_limits(config, **limits):
        raise TrainerError(limit, found=f"{limit.split()[0]} {found:g} ({type(config).__name__})")
