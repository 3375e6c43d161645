"""Effects on camera images: no motion shows them; recorded depth does, against a scene (realsim.gap.checks.camera)."""

from __future__ import annotations

from realsim.core.errors import GapError
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, nowhere


def unseen(name: str, title: str, description: str, signature: str, parameter: Parameter) -> Effect:
    """An effect of the contract that the search over motions never tries, and says where it is."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        raise GapError(
            f"{name} acts on camera images, which no simulated motion shows",
            hint="leave it out of the effects: where a log has depth frames it is tried anyway",
        )

    return Effect(
        name=name,
        title=title,
        scope="global",
        description=description,
        signature=signature,
        excitation="Depth frames in the log, and a scene to compare them with. Motion alone never shows it.",
        places=nowhere,
        parameters=lambda context, place: (parameter,),
        excited_by=lambda context, place: Excitation(
            False, "it is told by the camera's depth frames against the scene, not by motion"
        ),
        apply=apply,
        patchable=False,
    )
