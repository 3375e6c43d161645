"""One case on disk: read, diagnose, write."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from realsim.core.errors import extra
from realsim.core.files import check_size, inside, output_folder, read_bytes, write_bytes, write_text
from realsim.gap.answer.camera import with_camera
from realsim.gap.answer.patch import asset_files
from realsim.gap.case.case import load_case
from realsim.gap.case.health import examine
from realsim.gap.case.stuck import with_same_joints
from realsim.gap.checks.footholds.run import check_camera
from realsim.gap.config import DiagnoseConfig
from realsim.gap.drift.pair import pair_of
from realsim.gap.drift.since import changed_since
from realsim.gap.pipeline import Progress, diagnose, limited
from realsim.gap.simulation.simulate import Simulator


def run_case(
    folder: Path,
    out: Path,
    config: DiagnoseConfig | None = None,
    progress: Progress | None = None,
    *,
    overwrite: bool = False,
    scene: Path | None = None,
    recordings: Sequence[Path] = (),
    since: Path | None = None,
) -> dict[str, Any]:
    """Diagnose the case in `folder` and write diagnosis.json, model.xml (patched) and report.html to `out`.

    Where the log has depth frames, their camera is checked against the scene too: camera_delay, camera_mount and
    depth_noise are then among the causes.

    Args:
        scene: scene.xml that depth frames are compared with; the terrain of model.xml if None.
        recordings: runs that were recorded after `realsim excite`; they are not written into the case.
        since: case of an earlier log of the same robot: what changed since then is reported too.

    Returns what diagnosis.json holds. Raises GapError with the reason where a log cannot support a diagnosis.
    """
    config = config or DiagnoseConfig()
    if config.signals:
        extra("mcap.writer", "logs", "writing signals.mcap")
    with output_folder(
        Path(out), overwrite=overwrite
    ) as work:  # what cannot be written is refused before the work is done
        case = load_case(Path(folder), recordings)
        if since is not None:  # what cannot be compared is refused before the work is done
            earlier = load_case(Path(since))
            pair_of(case, earlier, config)
        assets = asset_files(case.spec)
        for name in assets:
            check_size(inside(Path(folder), name))
        camera = check_camera(case, scene)  # seconds; what is wrong with its frames is reported before the search
        found = with_camera(diagnose(case, config, progress), camera)
        if found.next_experiment is not None:
            where = os.path.relpath(Path(folder).absolute(), Path(out).absolute())
            proposal = found.next_experiment | {"case": Path(where).as_posix()}
            found = replace(found, next_experiment=proposal)
        if since is not None:
            pair = with_same_joints(limited(case, config), limited(earlier, config))
            changed = changed_since(*pair, config, progress or _quiet)
            found = replace(found, since={"case": earlier.folder.name, **changed.as_dict()})
        found.write(work)
        assert found.evidence is not None  # `diagnose` fills it
        write_text(work / "model.xml", found.evidence.patched_xml)
        for name in assets:  # so that the patched model loads where it lies
            write_bytes(inside(work, name), read_bytes(inside(Path(folder), name)))
        if config.report:
            from realsim.gap.report import write_report

            write_report(work / "report.html", found)
        if config.signals:
            from realsim.gap.report.signals import write_signals

            write_signals(work / "signals.mcap", found, str(found.as_dict()["sentence"]))
    return found.as_dict()


def _quiet(what: str, share: float) -> None:
    del what, share


def check_case(folder: Path, config: DiagnoseConfig | None = None) -> dict[str, Any]:
    """The health of a log alone, in seconds: clocks, conventions, noise, starts, and what is odd about them.

    Returns:
        `runs` (their names), `seconds` (of log), and `health` as in diagnosis.json.

    Raises:
        GapError: where no diagnosis is possible, with the reason.
    """
    config = config or DiagnoseConfig()
    case = limited(load_case(Path(folder)), config)
    with Simulator(case, config) as simulator:
        health = examine(simulator)
    return {
        "runs": [run.name for run in case.runs],
        "seconds": round(sum(run.duration for run in case.runs), 2),
        "health": health,
    }
