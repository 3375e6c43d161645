"""Views are kept while all of them fit into the budget, and nobody can change them."""

from collections.abc import Callable

import numpy as np
import pytest

from realsim.core.types import PointView
from realsim.feedforward.backend import Kept

SIZE = 4 * 5 * (12 + 4 + 1 + 3)


def loader(made: list[int]) -> Callable[[int], PointView]:
    def load(i: int) -> PointView:
        made.append(i)
        shape = (4, 5)
        points, color = np.full((*shape, 3), i, np.float32), np.zeros((*shape, 3), np.uint8)
        return PointView(points, np.ones(shape, np.float32), np.ones(shape, bool), color)

    return load


@pytest.mark.parametrize(("budget", "times"), [(3 * SIZE, 1), (3 * SIZE - 1, 2)])
def test_views_are_made_once_if_all_fit(budget: int, times: int) -> None:
    made: list[int] = []
    views = Kept(loader(made), 3, budget)
    for _ in range(2):
        assert [float(views(i).points[0, 0, 0]) for i in range(3)] == [0, 1, 2]
    assert sorted(made) == sorted(list(range(3)) * times)


def test_a_kept_view_cannot_be_written_into() -> None:
    view = Kept(loader([]), 1)(0)
    with pytest.raises(ValueError, match="read-only"):
        view.points[0, 0, 0] = 7
