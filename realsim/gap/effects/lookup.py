"""Effects, nuisances, and changes of either between two logs of one robot, by name."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from realsim.gap.case.model.context import Context
from realsim.gap.effects import EFFECTS
from realsim.gap.effects.base import Effect, Parameter, Place, Rivals, Suggestion
from realsim.gap.effects.nuisances import NUISANCES

SINCE = " since"
"""Ends the name of an effect that acts in the later one of two logs only, on top of what acts in both."""
DAILY = 0.5
"""Standard deviation of what comes and goes from day to day, as a share of the everyday deviations between robots: a
joint's friction differs by some percent between a cold and a warm morning. Not tuned."""
PLACES = {"joint": "joints", "body": "bodies", "terrain": "bodies", "actuator": "actuators"}
"""Scope of an effect -> key of the places in a cause of the contract's form; those of the other scopes have none."""


def lookup(name: str) -> Effect:
    """An effect of the library, one of the nuisances, or a change of one."""
    if name.endswith(SINCE):
        return _change(name.removesuffix(SINCE))
    return NUISANCES[name] if name in NUISANCES else EFFECTS[name]


@lru_cache
def _change(name: str) -> Effect:
    """The same law in the same coordinates, which count from what both logs share (`Simulator.edited`)."""
    effect = lookup(name)
    rivals = effect.rivals

    def parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
        return tuple(
            replace(p, nuisance=DAILY * p.nuisance, usual=0.0, like=p.like and (p.like[0] + SINCE, p.like[1]))
            for p in effect.parameters(context, place)
        )

    def suggest(context: Context, place: Place, values: dict[str, float]) -> Sequence[Suggestion]:
        return [replace(s, effect=s.effect + SINCE) for s in rivals.suggest(context, place, values)]

    special, commoner = (n and n + SINCE for n in (rivals.special_case, rivals.commoner))
    others = Rivals(suggest, special, commoner, tuple(n + SINCE for n in rivals.compared))
    return replace(effect, name=name + SINCE, parameters=parameters, rivals=others)


_WHERE = {
    "joint": "on joints",
    "body": "on bodies",
    "actuator": "on actuators",
    "terrain": "on pieces of terrain",
    "global": "everywhere",
}


def explain(effect: str) -> str:
    """Plain text about one effect, or a line about each for `all`. Raises UnknownNameError with the closest names."""
    if effect == "all":
        width = max(len(name) for name in EFFECTS)
        return "\n".join(f"{name:{width}}  {EFFECTS[name].words.description}" for name in EFFECTS)
    e = EFFECTS[effect]
    how = "in the model (model.xml, apply_patch)" if e.patchable else "a wrapper around the simulator (see the patch)"
    rows = [("looks like", e.words.signature), ("excited by", "; ".join(e.words.excitation))]
    rows += [("told by", f"{d.record}, from {d.rival}") for d in e.words.told_by]
    parts = [f"{e.name}: {e.title}, acts {_WHERE.get(e.scope, f'on a {e.scope}')}", e.words.description]
    parts.append("\n".join(f"{label + ':':<12} {text}" for label, text in [*rows, ("in a patch", how)] if text))
    return "\n\n".join(filter(None, parts))


def places_of(cause: Mapping[str, Any]) -> list[str]:
    """Joints, bodies or actuators of a cause in the contract's form."""
    return [name for key in ("joints", "bodies", "actuators") for name in cause.get(key) or ()]
