"""A support that moves under load."""

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import SUPPORTS, Edit, Effect, Law, Parameter, Place, Words, on_the_ground


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    weight = 9.81 * context.total_mass
    soft, rock = 0.02 / weight, 0.15 / (0.05 * weight)
    return (
        Parameter("stiffness", "N/m", (0.0, 12 * soft), soft, report=lambda z: 1 / max(z, 1e-9)),
        Parameter("tilt_stiffness", "N m/rad", (0.0, 12 * rock), rock, report=lambda z: 1 / max(z, 1e-9)),
        Parameter("relaxation", "s", (0.002, 0.5), 0.02, default=0.03),
    )


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
    where=SUPPORTS,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        title="wobbling support",
        description="A support sinks or rocks on a spring and damper when it is loaded.",
        signature="The base sinks and leans toward a leg as load moves onto it, and swings after load changes.",
        excitation=("load moving on and off that support",),
        sort="thing",
    ),
    excited_by=on_the_ground,
    variants=(("stiffness", "relaxation"), ("tilt_stiffness", "relaxation")),
    law=Law(abrupt=True),
)
