"""Effects on camera images: no motion shows them; recorded depth does, against a scene (realsim.gap.checks.camera)."""

from realsim.core.errors import GapError
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, Where, Words, fixed


def unseen(name: str, description: str, signature: str, parameter: Parameter) -> Effect:
    """An effect of the contract that the search over motions never tries, and says where it is."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        raise GapError(
            f"{name} acts on camera images, which no simulated motion shows",
            hint="leave it out of the effects: where a log has depth frames it is tried anyway",
        )

    return Effect(
        name=name,
        where=Where("global", lambda context: []),
        parameters=fixed(parameter),
        apply=apply,
        words=Words(
            description=description,
            signature=signature,
            excitation=("depth frames in the log, and a scene to compare them with: motion alone never shows it",),
        ),
        excited_by=lambda context, place: Excitation(
            False, "the camera's depth frames against the scene show it, not motion"
        ),
        patchable=False,
    )


CAMERA_DELAY = unseen(
    "camera_delay",
    "Images are older than the log says.",
    "The depth image belongs to an earlier moment. Joints, base and IMU are right.",
    Parameter("delay", "s", (0.0, 0.3), 0.02),
)
CAMERA_MOUNT = unseen(
    "camera_mount",
    "The camera is mounted elsewhere than in the model.",
    "Depth is seen from another pose: all distances shift with the view direction. Joints, base and IMU are right.",
    Parameter("rotation", "rad", (0.0, 0.3), 0.02),
)
DEPTH_NOISE = unseen(
    "depth_noise",
    "Depth is noisier than the model says.",
    "Depth scatters, with holes and edges, more than the model's. Joints, base and IMU are right.",
    Parameter("sigma", "m", (0.0, 0.3), 0.02),
)
