"""Effects on camera images: they have a name and a description, but no robot log can show them."""

from __future__ import annotations

from realsim.errors import GapError
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, nowhere


def _unseen(name: str, description: str, signature: str, parameter: Parameter) -> Effect:
    """An effect of the contract that is never tried, and says why."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        raise GapError(
            f"{name} acts on camera images, which a robot log does not hold", hint="leave it out of the effects"
        )

    return Effect(
        name=name,
        title=name.replace("_", " "),
        scope="global",
        description=description,
        signature=f"{signature} Joints, base and IMU are right.",
        excitation="Camera images, which the log format does not carry yet: never excited.",
        places=nowhere,
        parameters=lambda context, place: (parameter,),
        excited_by=lambda context, place: Excitation(False, "the log holds no camera images, so nothing can show it"),
        apply=apply,
        patchable=False,
    )


DELAY = _unseen(
    "camera_delay",
    "Images are older than the log says.",
    "The depth image belongs to an earlier moment.",
    Parameter("delay", "s", (0.0, 0.3), 0.02),
)
MOUNT = _unseen(
    "camera_mount",
    "The camera is mounted elsewhere than in the model.",
    "Depth is seen from another pose: all distances shift with the view direction.",
    Parameter("rotation", "rad", (0.0, 0.3), 0.02),
)
NOISE = _unseen(
    "depth_noise",
    "Depth is noisier than the model says.",
    "Depth scatters, with holes and edges, more than the model's.",
    Parameter("sigma", "m", (0.0, 0.3), 0.02),
)
