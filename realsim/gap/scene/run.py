"""A log against its scene, on disk: read, survey, write."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from realsim.files import output_folder, to_json, write_text
from realsim.gap.logs.case import Case, load_case
from realsim.gap.scene.corrected import write_corrected
from realsim.gap.scene.footholds import FootholdMap, survey
from realsim.gap.scene.page import scene_page
from realsim.gap.scene.terrain import Terrain, load_terrain, terrain_of
from realsim.gap.scene.verdict import SceneVerdict, judge

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class SceneCheck:
    """What a robot's log says about the scene on which it walked."""

    verdict: SceneVerdict
    footholds: FootholdMap
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
            "notes": list(self.notes),
        }


def check_scene(case: Case, terrain: Terrain, progress: Progress | None = None) -> SceneCheck:
    """Survey the footholds and judge the scene; writes nothing.

    Raises:
        GapError: the log lacks base pose, contacts or positions, or does not lie on the scene.
    """
    with threadpool_limits(1, user_api="blas"):  # the matrices are too small to gain from threads
        found = survey(case, terrain, progress)
    return SceneCheck(judge(found, terrain.file), found, case.warnings)


def run_scene(
    folder: Path, scene: Path | None, out: Path, progress: Progress | None = None, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write footholds.json, report.html and the corrected scene.xml to `out`; returns what footholds.json holds.

    Args:
        folder: a case (docs/gap.md).
        scene: scene.xml or its folder; the terrain of the case's model.xml if None.
    """
    with output_folder(Path(out), overwrite=overwrite, source=Path(folder)) as work:
        case = load_case(Path(folder))
        terrain = load_terrain(scene) if scene is not None else terrain_of_case(case)
        checked = check_scene(case, terrain, progress)
        weight = 9.81 * float(case.model.body_subtreemass[0])
        notes = list(checked.notes)
        notes += write_corrected(work, terrain, checked.footholds, weight)
        data = checked.as_dict() | {"notes": notes}
        write_text(work / "footholds.json", to_json(data))
        write_text(
            work / "report.html",
            scene_page(checked.verdict, checked.footholds, terrain, case.folder.absolute().name, notes, []),
        )
    return data


def terrain_of_case(case: Case) -> Terrain:
    """The terrain that stands in the case's own model."""
    return terrain_of(case.spec, case.spec.copy().compile(), case.folder / "model.xml")
