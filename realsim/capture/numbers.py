"""Tables of numbers from parsed JSON or YAML, in which `true` is not 1."""

from typing import Any

import numpy as np

from realsim.core.types import F64


def table_of(value: Any) -> F64:
    """Nested lists of numbers as an array; what is no number (`true`, `null`, words) is NaN, to be refused where it is.

    Raises:
        ValueError: not nested lists of equal length.
    """
    cells = np.array(value, dtype=object)
    return np.array([_number(cell) for cell in cells.flat], dtype=float).reshape(cells.shape)


def _number(cell: Any) -> float:
    if isinstance(cell, (list, dict)):
        raise ValueError("rows of different length")
    try:
        return float("nan") if isinstance(cell, bool) else float(cell)
    except (TypeError, ValueError):
        return float("nan")
    except OverflowError:
        return float("inf")
