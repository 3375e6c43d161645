"""Effects on camera images: they have a name and a description, but no robot log can show them."""

from __future__ import annotations

from realsim.errors import GapError
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, nowhere


def unseen(name: str, title: str, description: str, signature: str, parameter: Parameter) -> Effect:
    """An effect of the contract that is never tried, and says why."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        raise GapError(
            f"{name} acts on camera images, which a robot log does not hold", hint="leave it out of the effects"
        )

    return Effect(
        name=name,
        title=title,
        scope="global",
        description=description,
        signature=signature,
        excitation="Camera images, which the log format does not carry yet: never excited.",
        places=nowhere,
        parameters=lambda context, place: (parameter,),
        excited_by=lambda context, place: Excitation(False, "the log holds no camera images, so nothing can show it"),
        apply=apply,
        patchable=False,
    )
