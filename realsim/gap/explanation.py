"""Descriptions of effects: their appearance in a log, and what excites them."""

from __future__ import annotations

from realsim.gap.effects import EFFECTS

_WHERE = {"joint": "on joints", "body": "on bodies", "terrain": "on pieces of terrain", "global": "everywhere"}


def explain(effect: str) -> str:
    """Plain text about one effect, or a line about each for `all`. Raises UnknownNameError with the closest names."""
    if effect == "all":
        width = max(len(name) for name in EFFECTS)
        return "\n".join(f"{name:{width}}  {EFFECTS[name].description}" for name in EFFECTS)
    e = EFFECTS[effect]
    how = "in the model (model.xml, apply_patch)" if e.patchable else "a wrapper around the simulator (see the patch)"
    return "\n".join(
        [
            f"{e.name}: {e.title}, acts {_WHERE[e.scope]}",
            "",
            e.description,
            "",
            f"looks like:  {e.signature}",
            f"excited by:  {e.excitation}",
            f"in a patch:  {how}",
        ]
    )
