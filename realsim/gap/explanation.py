"""Descriptions of effects: their appearance in a log, and what excites them."""

from __future__ import annotations

from realsim.gap.effects import EFFECTS

_WHERE = {"joint": "on joints", "body": "on bodies", "terrain": "on pieces of terrain", "global": "everywhere"}


def explain(effect: str) -> str:
    """Plain text about one effect, or a line about each for `all`. Raises UnknownNameError with the closest names."""
    if effect == "all":
        width = max(len(name) for name in EFFECTS)
        return "\n".join(f"{name:{width}}  {EFFECTS[name].words.description}" for name in EFFECTS)
    e = EFFECTS[effect]
    how = "in the model (model.xml, apply_patch)" if e.patchable else "a wrapper around the simulator (see the patch)"
    return "\n".join(
        [
            f"{e.name}: {e.title}, acts {_WHERE[e.scope]}",
            "",
            e.words.description,
            "",
            f"looks like:  {e.words.signature}",
            f"excited by:  {'; '.join(e.words.excitation)}",
            *(f"told by:     {d.record}, from {d.rival}" for d in e.words.told_by),
            f"in a patch:  {how}",
        ]
    )
