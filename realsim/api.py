"""The functions of `import realsim as rs`: what the command line does, with paths as text or Path, and typed results.

```python
import realsim as rs

scene = rs.reconstruct("frames", "scene")
print(scene.verdict, scene.reasons)
rs.export(scene, to=["usd", "urdf"])
found = rs.diagnose("case", "diagnosis")
print(found.causes)
```
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from realsim.core.engine import check_mujoco
from realsim.core.errors import GapError, require
from realsim.core.recognise import explain_inputs, whole

if TYPE_CHECKING:
    from realsim.capture import CaptureConfig, Inspection
    from realsim.export import Exported
    from realsim.export.config import SceneConfig
    from realsim.gap import Case, DiagnoseConfig
    from realsim.gap.config import ExciteConfig
    from realsim.pipeline import ReconstructConfig
    from realsim.results import Diagnosis, Scene

StrPath = str | os.PathLike[str]
Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done, 0..1."""


@explain_inputs
def inspect(capture: StrPath, config: CaptureConfig | None = None) -> Inspection:
    """How a capture or scan is recognised, every assumed convention, and what is wrong with it.

    `print(found.render())` shows the result as the command line does.

    Args:
        capture: a folder of frames in any of the layouts, or a scan file.
        config: how to read it; by default everything is recognised.

    Raises:
        CaptureError: it is not recognised, or nothing in it can be used.
    """
    require("recon", "reading a capture")
    from realsim.capture import CaptureConfig
    from realsim.capture import inspect as look

    return look(Path(capture), config or CaptureConfig())


@explain_inputs
def reconstruct(
    capture: StrPath,
    out: StrPath = "scene",
    config: ReconstructConfig | None = None,
    *,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> Scene:
    """Turn a capture or scan into a metric, level, collidable MuJoCo scene, checked.

    Look at `verdict` and `reasons` of the result before you use it.

    Args:
        capture: a folder of frames in any of the layouts, or a scan file.
        out: the scene's folder; it appears only when everything in it is complete.
        config: what to do otherwise than by default.
        progress: called with what is being done and its share, now and then; a terminal shows bars without it.
        overwrite: replace a scene that is there already.

    Returns:
        The scene; `details` has the arrays of every stage.

    Raises:
        RealsimError: bad input or an impossible request; nothing is left behind at `out`.
    """
    check_mujoco()
    from realsim.results import Scene

    require("recon", "reconstructing a scene")
    from realsim import pipeline
    from realsim.core.progress import heard_by

    config = config or pipeline.ReconstructConfig()
    if overwrite:
        config = replace(config, overwrite=True)
    with heard_by(progress):
        result = pipeline.reconstruct(Path(capture), Path(out), config)
    return Scene.read(result.scene.folder, details=result)


@explain_inputs
def contact(
    mesh: StrPath,
    out: StrPath = "contact",
    config: SceneConfig | None = None,
    *,
    unit: Literal["m", "cm", "mm", "inch"] | None = None,
    up: Literal["auto", "z", "y"] = "auto",
    ground_z: float | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> Scene:
    """Give a mesh collision geometry for MuJoCo, chosen by measured error and cost.

    Args:
        mesh: .ply, .obj, .stl, .glb or .off.
        out: the scene's folder.
        config: tolerance, kind of geometry, robot.
        unit: of the file; metres if None.
        up: axis of the file that points up.
        ground_z: height of the ground, metres; found from the mesh if None.
        progress: called with what is being done and its share, now and then.
        overwrite: replace a folder that realsim wrote before.

    Raises:
        ExportError: the mesh cannot be used, or the scene does not hold what is dropped on it.
    """
    check_mujoco()
    from realsim.results import Scene

    require("recon", "measured contact geometry")
    from realsim.core.files import output_folder
    from realsim.core.progress import heard_by
    from realsim.export import contact_mesh
    from realsim.export.config import SceneConfig
    from realsim.report.contact_page import write_contact_page

    with heard_by(progress), output_folder(Path(out), overwrite=overwrite, source=Path(mesh)) as folder:
        files = contact_mesh(Path(mesh), folder, config or SceneConfig(), unit=unit, up=up, ground_z=ground_z)
        write_contact_page(folder, files)
    return Scene.read(Path(out))


@explain_inputs
def export(
    scene: Scene | StrPath, to: str | Sequence[str] = "all", out: StrPath | None = None, *, overwrite: bool = False
) -> Exported:
    """Write a scene in the formats of other tools.

    Args:
        scene: a result of `reconstruct`, `contact` or `load_scene`, or a scene's folder.
        to: names of `realsim.export.EXPORTERS`, or "all" for every one whose packages are installed.
        out: gets one folder per format; `export` in the scene's folder if None.
        overwrite: replace formats that are there already.

    Returns:
        A dictionary {format: files written}; its `skipped` says which of "all" were left out, and why.

    Raises:
        UnknownNameError: no such format, before anything is written.
        MissingExtraError: a format requested by name needs a package that is not installed.
    """
    from realsim.export import export_scene
    from realsim.results import Scene

    folder = scene.folder if isinstance(scene, Scene) else whole(Path(scene))
    return export_scene(folder, to, None if out is None else Path(out), overwrite=overwrite)


def load_scene(folder: StrPath) -> Scene:
    """Read a scene that `reconstruct` or `contact` wrote: verdict, figures, and the model on request."""
    return _scene(scene=folder)


@explain_inputs
def _scene(scene: StrPath) -> Scene:
    from realsim.results import Scene

    return Scene.read(whole(Path(scene)))


def load_case(folder: StrPath) -> Case:
    """Read a robot's logs with their model: a folder with log.json, model.xml and runs/.

    Raises:
        GapError: with the file, what was expected and what was found.
    """
    return _case(case=folder)


@explain_inputs
def _case(case: StrPath) -> Case:
    from realsim.gap import load_case as load

    return load(whole(Path(case)))


@explain_inputs
def diagnose(
    case: Case | StrPath,
    out: StrPath | None = None,
    config: DiagnoseConfig | None = None,
    *,
    progress: Progress | None = None,
    overwrite: bool = False,
    recordings: Sequence[StrPath] = (),
    since: StrPath | None = None,
    scene: StrPath | None = None,
) -> Diagnosis:
    """Say where a robot's logs differ from its simulator, which unmodelled effect causes it, and how much it matters.

    Args:
        case: a folder with log.json, model.xml and runs/; or, where nothing is written, the result of `load_case`.
        out: gets diagnosis.json, the patched model.xml and report.html; nothing is written if None.
        config: what to do otherwise than by default.
        progress: called with what is done and its share, now and then; minutes pass for a robot with many joints.
        overwrite: replace a diagnosis that is there already.
        recordings: runs that were recorded after `next_experiment`: files, or the folder of an experiment. Of a case
            that is given as a folder.
        since: a case of an earlier log of the same robot; what changed is under `since` of `data`. Needs `out`.
        scene: scene.xml that the depth frames of the log are compared with; the terrain of the case's model if None.
            Depth frames are only looked at with `out`.

    Raises:
        GapError: the log cannot support a diagnosis, with the reason.
    """
    check_mujoco()
    from realsim import gap
    from realsim.results import Diagnosis

    if out is not None:
        folder = case.folder if isinstance(case, gap.Case) else Path(case)
        new = [Path(r) for r in recordings]
        earlier = None if since is None else Path(since)
        terrain = None if scene is None else Path(scene)
        data = gap.run_case(
            folder, Path(out), config, progress, overwrite=overwrite, scene=terrain, recordings=new, since=earlier
        )
        return Diagnosis.of(data, Path(out))
    for name, given in (("since", since), ("scene", scene)):
        if given is not None:
            raise GapError(f"{name} needs an output folder", expected=f"rs.diagnose(case, out, {name}=...)")
    loaded = case if isinstance(case, gap.Case) else gap.load_case(Path(case), [Path(r) for r in recordings])
    return Diagnosis.of(gap.diagnose(loaded, config, progress).as_dict())


@explain_inputs
def next_experiment(
    source: StrPath,
    out: StrPath | None = None,
    config: ExciteConfig | None = None,
    *,
    case: StrPath | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> Mapping[str, Any]:
    """Choose the experiment that tells the causes of an ambiguous diagnosis apart, within the robot's limits.

    Args:
        source: the folder of a diagnosis; or a case, which is diagnosed first.
        out: gets the command files, the instructions and a page; nothing is written if None.
        config: which excitations, how long, and the limits.
        case: the case of a diagnosis, where it is not where it was when it was diagnosed.
        progress: called with what is done and its share, now and then.
        overwrite: replace an experiment for which nothing was recorded yet.

    Returns:
        What experiment.json holds: `text`, `excitation`, `decides`, `expected_posterior`, `instructions`, ...

    Raises:
        GapError: nothing is to be distinguished, or nothing within the limits tells it.
    """
    check_mujoco()
    from realsim.gap.excite import excite

    folder = None if case is None else Path(case)
    target = None if out is None else Path(out)
    return excite(Path(source), target, config, None, progress, case=folder, overwrite=overwrite)


@explain_inputs
def footholds(
    case: Case | StrPath,
    scene: StrPath | None = None,
    out: StrPath | None = None,
    *,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> Mapping[str, Any]:
    """Say what a robot's feet, and its depth camera if it recorded, tell of the scene on which it walked.

    Args:
        case: a folder with log.json, model.xml and runs/, with base pose, contacts and joint positions in every run;
            or, where nothing is written, the result of `load_case`.
        scene: scene.xml on which the robot walked, or its folder; the terrain in the case's model.xml if None.
        out: gets footholds.json, report.html with the map, and the corrected scene.xml; nothing is written if None.
        progress: called with what is done and its share, now and then.
        overwrite: replace an output folder that realsim wrote before.

    Returns:
        What footholds.json holds: `verdict`, `changed` (names), `footholds`, `camera`, `notes`, ...

    Raises:
        GapError: the log lacks base pose, contacts or positions, or does not lie on the scene.
    """
    check_mujoco()
    from realsim import gap
    from realsim.gap.checks.footholds.run import check_scene, run_scene, terrain_under

    where = None if scene is None else Path(scene)
    if out is not None:
        folder = case.folder if isinstance(case, gap.Case) else Path(case)
        return run_scene(folder, where, Path(out), progress, overwrite=overwrite)
    loaded = case if isinstance(case, gap.Case) else gap.load_case(Path(case))
    return check_scene(loaded, terrain_under(loaded, where), progress).as_dict()


def load_diagnosis(folder: StrPath) -> Diagnosis:
    """Read diagnosis.json of a folder that `diagnose` wrote."""
    from realsim.core.files import read_json
    from realsim.results import Diagnosis

    return Diagnosis.of(read_json(Path(folder) / "diagnosis.json"), Path(folder))


def apply_patch(spec: Any, patch: Diagnosis | Mapping[str, Any]) -> Any:
    """Change a `mujoco.MjSpec` of the diagnosed model in place; compile it afterwards.

    Args:
        spec: of the model that was diagnosed; the names must match.
        patch: a diagnosis, or `patch` of diagnosis.json.

    Returns:
        What no compiled model can hold (delays, encoder offsets, ...), for the loop that steps it.

    Raises:
        GapError: a patch of another format, or a model without the named parts.
    """
    from realsim.gap import apply_patch as apply
    from realsim.results import Diagnosis

    try:
        return apply(spec, dict(patch.patch if isinstance(patch, Diagnosis) else patch))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise GapError(
            "the patch is damaged", expected="`patch` of diagnosis.json", found=f"{type(error).__name__}: {error}"
        ) from error
