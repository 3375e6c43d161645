"""What recorded depth says of its camera, put into a diagnosis."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.verdicts import GapVerdict

if TYPE_CHECKING:
    from realsim.gap.checks.camera.calibrate import CameraFound


def with_camera(found: Diagnosis, camera: CameraFound | None) -> Diagnosis:
    """The diagnosis with the camera's effects among its causes.

    The motion does not depend on the camera here (the commands are those of the log), so the two are judged apart: a
    camera that is off is a cause beside those of the motion, and where these show no gap the verdict is `identified`.
    """
    if camera is None:
        return found
    statistics = found.statistics | {"camera": camera.as_dict()}
    if not camera.named:
        return replace(found, statistics=statistics)
    said = "; ".join(camera.sentences())
    found = replace(found, causes=(*found.causes, *camera.causes()), statistics=statistics)
    if found.verdict is not GapVerdict.NO_GAP:
        return replace(found, sentence=f"{found.sentence} Beside the motion: {said}.")
    return replace(
        found,
        verdict=GapVerdict.IDENTIFIED,
        sentence=f"{said[:1].upper()}{said[1:]}. In the motion: {found.sentence[:1].lower()}{found.sentence[1:]}",
        advice="correct the camera; change nothing else in the model",
    )
