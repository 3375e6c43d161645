"""A log against its scene, on disk: read, survey, write."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from realsim.core.files import output_folder, to_json, write_text
from realsim.core.types import F64
from realsim.gap.case.case import Case, load_case
from realsim.gap.checks.camera.calibrate import CameraFound, calibrate
from realsim.gap.checks.camera.rays import Correction
from realsim.gap.checks.camera.recorded import depth_camera
from realsim.gap.checks.camera.terrain import Terrain, load_terrain, terrain_of
from realsim.gap.checks.footholds.corrected import write_corrected
from realsim.gap.checks.footholds.footholds import FootholdMap, survey
from realsim.gap.checks.footholds.page import camera_cards, scene_page
from realsim.gap.checks.footholds.verdict import SceneVerdict, judge

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class SceneCheck:
    """What a robot's log says about the scene on which it walked."""

    verdict: SceneVerdict
    footholds: FootholdMap
    camera: CameraFound | None = None
    """What its depth camera is like, where it recorded."""
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """JSON-able; footholds.json."""
        found = self.footholds
        return {
            "verdict": self.verdict.as_dict(),
            "scan": self.verdict.scan,
            "footholds": [h.as_dict() for h in found.footholds],
            "changed": [h.name for h in found.changed],
            "contacts": found.contacts,
            "contacts_beside_all_tops": found.lost,
            "base_height_off_m": list(found.base),
            "repeatability_m": found.scatter,
            "camera": None if self.camera is None else self.camera.as_dict(),
            "notes": list(self.notes),
        }


def check_scene(case: Case, terrain: Terrain, progress: Progress | None = None) -> SceneCheck:
    """Survey the footholds and judge the scene; writes nothing.

    Raises:
        GapError: the log lacks base pose, contacts or positions, or does not lie on the scene.
    """
    with threadpool_limits(1, user_api="blas"):  # the matrices are too small to gain from threads
        found = survey(case, terrain, progress)
        camera = calibrate(case, terrain, by_feet(case, found), progress)
    verdict = judge(found, terrain.file, camera)
    return SceneCheck(verdict, found, camera, case.warnings + (camera.notes if camera else ()))


def check_camera(case: Case, scene: Path | None, progress: Progress | None = None) -> CameraFound | None:
    """The depth camera of a log alone; None where it recorded nothing. Feet steady the base's pose where they can."""
    if depth_camera(case) is None:
        return None
    terrain = terrain_under(case, scene)
    with threadpool_limits(1, user_api="blas"):
        stands = case.floating and all(case.has(s) for s in ("base_pos", "base_quat", "contact"))
        correction = by_feet(case, survey(case, terrain, progress)) if stands else None
        return calibrate(case, terrain, correction, progress)


def by_feet(case: Case, found: FootholdMap) -> Correction:
    """How much the logged base is off, from feet on the scene, for a place on the robot."""

    def correct(run: int, time: float, place: F64) -> F64:
        logged = case.runs[run]
        base = [np.interp(time, logged.time, column) for column in logged.signals["base_pos"].T]
        return found.correction(run, time, place - np.array(base))

    return correct


def run_scene(
    folder: Path, scene: Path | None, out: Path, progress: Progress | None = None, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write footholds.json, report.html and the corrected scene.xml to `out`; returns what footholds.json holds.

    Args:
        folder: a case (docs/diagnose.md).
        scene: scene.xml or its folder; the terrain of the case's model.xml if None.
    """
    with output_folder(Path(out), overwrite=overwrite, source=Path(folder)) as work:
        case = load_case(Path(folder))
        terrain = terrain_under(case, scene)
        checked = check_scene(case, terrain, progress)
        weight = 9.81 * float(case.model.body_subtreemass[0])
        notes = list(checked.notes)
        notes += write_corrected(work, terrain, checked.footholds, weight)
        data = checked.as_dict() | {"notes": notes}
        write_text(work / "footholds.json", to_json(data))
        name, cards = case.folder.absolute().name, camera_cards(checked.camera)
        html = scene_page(checked.verdict, checked.footholds, terrain, name, notes, cards)
        write_text(work / "report.html", html)
    return data


def terrain_under(case: Case, scene: Path | None) -> Terrain:
    """The terrain of a scene; None: that in the case's own model."""
    if scene is not None:
        return load_terrain(scene)
    return terrain_of(case.spec, case.spec.copy().compile(), case.folder / "model.xml")
