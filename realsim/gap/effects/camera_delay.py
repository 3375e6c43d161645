"""Images are older than the log says."""

from __future__ import annotations

from realsim.errors import GapError
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, nowhere


def _parameters(context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("delay", "s", (0.0, 0.3), 0.02),)


def _excited(context, place: Place) -> Excitation:
    return Excitation(False, "the log holds no camera images, so nothing can show it")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    raise GapError(
        "camera_delay acts on camera images, which a robot log does not hold", hint="leave it out of the effects"
    )


EFFECT = Effect(
    name="camera_delay",
    title="camera delay",
    scope="global",
    description="Images are older than the log says.",
    signature="The depth image belongs to an earlier moment. Joints, base and IMU are right.",
    excitation="Camera images, which the log format does not carry yet: never excited.",
    places=nowhere,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    patchable=False,
)
