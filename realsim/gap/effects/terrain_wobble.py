"""A support that moves under load."""

from __future__ import annotations

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place


def _places(context: Context) -> list[Place]:
    return [(name,) for name in context.terrain]


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    weight = 9.81 * context.total_mass
    soft, rock = 0.02 / weight, 0.15 / (0.05 * weight)
    return (
        Parameter("stiffness", "N/m", (0.0, 12 * soft), soft, report=lambda z: 1 / max(z, 1e-9)),
        Parameter("tilt_stiffness", "N m/rad", (0.0, 12 * rock), rock, report=lambda z: 1 / max(z, 1e-9)),
        Parameter("relaxation", "s", (0.002, 0.5), 0.02, default=0.03),
    )


def _excited(context: Context, place: Place) -> Excitation:
    return Excitation(context.touches, "the robot stands on it")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """Springs at the support's centre: up and down (`stiffness`) or about x and y (`tilt_stiffness`).

    The damper is given by the relaxation time: damping = relaxation * stiffness.
    """
    import mujoco

    for name in place:
        body = edit.spec.body(name)
        body.gravcomp = 1.0  # the support rests in its place without the robot
        if values["stiffness"] > 0:
            k = 1 / values["stiffness"]
            edit.add_spring_joint(
                body, f"{name}_sink", mujoco.mjtJoint.mjJNT_SLIDE, [0, 0, 1], k, k * values["relaxation"]
            )
        if values["tilt_stiffness"] > 0:
            k = 1 / values["tilt_stiffness"]
            for label, axis in (("roll", [1, 0, 0]), ("pitch", [0, 1, 0])):
                edit.add_spring_joint(
                    body, f"{name}_{label}", mujoco.mjtJoint.mjJNT_HINGE, axis, k, k * values["relaxation"]
                )


EFFECT = Effect(
    name="terrain_wobble",
    title="wobbling support",
    scope="terrain",
    description="A support sinks or rocks on a spring and damper when it is loaded.",
    signature="The base sinks and leans toward a leg as load moves onto it, and swings after load changes.",
    excitation="Load moving on and off that support.",
    absolute=True,
    places=_places,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    abrupt=True,
    variants=(("stiffness", "relaxation"), ("tilt_stiffness", "relaxation")),
)
