"""Depth is noisier than the model says."""

from __future__ import annotations

from realsim.errors import GapError
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, nowhere


def _parameters(context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("sigma", "m", (0.0, 0.3), 0.02),)


def _excited(context, place: Place) -> Excitation:
    return Excitation(False, "the log holds no camera images, so nothing can show it")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    raise GapError(
        "depth_noise acts on camera images, which a robot log does not hold", hint="leave it out of the effects"
    )


EFFECT = Effect(
    name="depth_noise",
    title="depth noise",
    scope="global",
    description="Depth is noisier than the model says.",
    signature="Depth scatters, with holes and edges, more than the model's. Joints, base and IMU are right.",
    excitation="Camera images, which the log format does not carry yet: never excited.",
    places=nowhere,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    patchable=False,
)
