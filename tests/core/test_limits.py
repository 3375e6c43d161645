"""Limits of configurations: what is beyond one is refused with its field, the limit and the value."""

from dataclasses import dataclass

import pytest

from realsim.capture.config import CaptureConfig
from realsim.core.limits import check_limits
from realsim.gap import DiagnoseConfig
from realsim.gap.config import ExciteConfig
from realsim.meshing.config import MeshConfig


@dataclass(frozen=True)
class Sizes:
    share: float = 0.5
    ends: tuple[float, float] = (1.0, 2.0)
    most: float | None = None

    def __post_init__(self) -> None:
        check_limits(self, above={"ends": 0}, least={"share": 0, "most": 3}, most={"share": 1})


def test_numbers_within_their_limits_pass_and_none_is_no_number() -> None:
    for share in (0.0, 0.5, 1.0):
        assert Sizes(share, (1e-9, 2.0), 3.0).most == 3.0
    assert Sizes().most is None


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: Sizes(share=1.5), "share must be at most 1, found 1.5"),
        (lambda: Sizes(share=-1), "share must be at least 0, found -1"),
        (lambda: Sizes(share=float("nan")), "share must be at least 0, found nan"),
        (lambda: Sizes(ends=(1.0, 0.0)), "ends must be above 0, found 0"),
        (lambda: Sizes(most=float("inf")), "most must be at least 3, found inf"),
        (lambda: DiagnoseConfig(max_runs=0), "max_runs must be at least 1, found 0"),
        (lambda: DiagnoseConfig(bin_seconds=0.0), "bin_seconds must be above 0, found 0"),
        (lambda: DiagnoseConfig(max_seconds=0.05), "max_seconds must be at least 0.1, found 0.05"),
        (lambda: ExciteConfig(seconds=20), "seconds must be at most 10, found 20"),
        (lambda: MeshConfig(max_triangles=3), "max_triangles must be at least 100, found 3"),
        (lambda: CaptureConfig(every=0), "every must be at least 1, found 0"),
    ],
)
def test_what_is_beyond_a_limit_is_refused_with_its_value(made, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        made()
