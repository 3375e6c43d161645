"""Words and short numbers of the report."""

from collections.abc import Iterable
from typing import Any

from realsim.gap.answer.sentence import SIGNALS
from realsim.gap.effects import EFFECTS
from realsim.report import svg

NOT_KEPT = "The arrays were not kept with this diagnosis."
HEAT = ((158, 168, 182), (196, 184, 140), (236, 160, 72), (222, 92, 48), (166, 24, 44))
"""Grey for no gap to dark red for the largest."""


def signal_name(signal: str) -> str:
    """joint_pos -> joint position."""
    return SIGNALS.get(signal, signal.replace("_", " "))


def title_of(effect: str) -> str:
    """The effect's title, or its name if it is not in the library."""
    return str(EFFECTS[effect].title) if effect in EFFECTS else effect.replace("_", " ")


def short(name: str, most: int = 20) -> str:
    """A joint's or body's name for a narrow label."""
    text = name.removesuffix("_joint").removesuffix("_link").replace("_", " ")
    return text if len(text) <= most else text[: most - 1] + "…"


def places(names: Iterable[str], most: int = 4) -> str:
    """Joints or bodies in a row; nothing given means everywhere."""
    listed = list(names)
    if not listed:
        return "everywhere"
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return ", ".join(n.replace("_", " ") for n in listed[:most]) + more


def after(stage: int) -> str:
    """In which company an effect was fitted: beside how many causes that were found before."""
    return f"after {stage} cause{'s' * (stage != 1)}"


def percent(share: float) -> str:
    """A share in percent; what is nearly all or nearly nothing does not round to all or nothing."""
    if share != share:
        return "–"
    if 0.9995 <= share < 1:
        return ">99.9 %"
    if 0 < share < 0.0005:
        return "<0.1 %"
    if 0 < share < 0.0095 or 0.985 <= share < 0.9995:
        return f"{100 * share:.1f} %"
    return f"{svg.number(round(100 * share), 3) if abs(share) < 10 else svg.number(100 * share, 2)} %"


def times(ratio: float) -> str:
    """A ratio: 3.2 ×."""
    return f"{svg.number(ratio, 2 if ratio < 100 else 3)} ×"


def interval(parameter: dict[str, Any]) -> str:
    """1.9 N m [1.6, 2.2]."""
    low, high = parameter["ci90"]
    value, unit = svg.number(parameter["value"]), parameter["unit"]
    return f"{value} {'×' if unit == 'ratio' else unit} [{svg.number(low)}, {svg.number(high)}]"
