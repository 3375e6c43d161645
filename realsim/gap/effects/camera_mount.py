"""The camera is mounted elsewhere than in the model."""

from __future__ import annotations

from realsim.errors import GapError
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, nowhere


def _parameters(context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("rotation", "rad", (0.0, 0.3), 0.02),)


def _excited(context, place: Place) -> Excitation:
    return Excitation(False, "the log holds no camera images, so nothing can show it")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    raise GapError(
        "camera_mount acts on camera images, which a robot log does not hold", hint="leave it out of the effects"
    )


EFFECT = Effect(
    name="camera_mount",
    title="camera mount",
    scope="global",
    description="The camera is mounted elsewhere than in the model.",
    signature="Depth is seen from another pose than the model's: all distances shift with the view direction. Joints, "
    "base and IMU are right.",
    excitation="Camera images, which the log format does not carry yet: never excited.",
    places=nowhere,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    patchable=False,
)
