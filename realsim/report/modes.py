"""Sources of points side by side, where a comparison was requested."""

from realsim.core.types import Mode, Reconstruction
from realsim.report import page
from realsim.report.verdict import millimetres

_HEADS = ["source", "frames", "scale ± (90 %)", "depth to mesh", "seen", "start to goal", "apart", "time"]


def modes_card(result: Reconstruction) -> list[str]:
    """A table with one line per source; nothing without a comparison."""
    if not result.modes:
        return []
    rows = [_row(mode, delivered=k == 0) for k, mode in enumerate(result.modes)]
    note = (
        "The same capture by each source of points. Each has a unit of its own, so only the interval of the scale can "
        "be compared. Apart: median distance of its surface from the delivered one, both in their simulation frames."
    )
    return [page.card("Sources of points compared", page.table(_HEADS, rows, raw=[0]), note, wide=True)]


def _row(mode: Mode, *, delivered: bool) -> list[str]:
    name = page.esc(mode.backend) + ("<small>delivered</small>" if delivered else "")
    if mode.error is not None:
        return [f"{name}<small>{page.esc(mode.error)}</small>", *["-"] * (len(_HEADS) - 1)]
    low, high = mode.scale_ci90
    return [
        name,
        f"{mode.used} used, {mode.dropped} dropped",
        f"{50 * (high - low):.2f} %",
        "-" if mode.depth_to_mesh_m is None else millimetres(mode.depth_to_mesh_m),
        f"{mode.seen_m2:.1f} m²",
        "-" if mode.start_to_goal_m is None else f"{mode.start_to_goal_m:.3f} m",
        "-" if mode.apart_m is None else millimetres(mode.apart_m),
        f"{mode.seconds:.1f} s",
    ]
