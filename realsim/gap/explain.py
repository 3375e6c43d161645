"""What an effect looks like and what excites it, in words."""

from __future__ import annotations

from realsim.gap.effects import EFFECTS


def explain(effect: str) -> str:
    """Plain text about one effect. Raises UnknownNameError with the closest names."""
    e = EFFECTS[effect]
    where = {
        "joint": "on joints",
        "body": "on bodies",
        "terrain": "on pieces of terrain",
        "global": "everywhere",
    }[e.scope]
    how = "expressed in MJCF" if e.patchable else "a wrapper around the simulator (see the patch)"
    return "\n".join(
        [
            f"{e.name}: {e.title}, acts {where}",
            "",
            e.description,
            "",
            f"looks like:  {e.signature}",
            f"excited by:  {e.excitation}",
            f"in a patch:  {how}",
        ]
    )
