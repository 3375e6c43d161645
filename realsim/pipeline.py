"""A folder of frames (or a scan) becomes a MuJoCo scene. The only place that knows the order of the stages."""

from __future__ import annotations

import ctypes
import dataclasses
import json
import resource
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import tyro
from threadpoolctl import threadpool_limits

from realsim import align, capture, changes, feedforward, meshing, report, robots, scale
from realsim.align.config import AlignConfig
from realsim.capture.config import CaptureConfig
from realsim.core import modes
from realsim.core.cache import StageCache, code_digest, default_folder, source_digest
from realsim.core.errors import RealsimError
from realsim.core.files import digest, inside, output_folder, write_bytes
from realsim.core.progress import Remaining, note, whole
from realsim.core.types import (
    AlignedScene,
    FrameSet,
    MetricScene,
    Mode,
    Pointmaps,
    Reconstruction,
    Scan,
    SceneFiles,
    StageTime,
    TerrainMesh,
)
from realsim.export import write_scene
from realsim.export.config import SceneConfig
from realsim.feedforward.config import PointsConfig
from realsim.meshing.config import MeshConfig
from realsim.scale.config import ScaleConfig

T = TypeVar("T")


@dataclass(frozen=True)
class ReconstructConfig:
    """Everything that can be set about a reconstruction; each stage owns its part."""

    capture: CaptureConfig = field(default_factory=CaptureConfig)
    points: PointsConfig = field(default_factory=PointsConfig)
    scale: ScaleConfig = field(default_factory=ScaleConfig)
    align: AlignConfig = field(default_factory=AlignConfig)
    mesh: MeshConfig = field(default_factory=MeshConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    overwrite: bool = False
    """Replace an output folder that realsim wrote before (only once the new scene is complete)."""
    seed: int = 0
    """Seed of everything random in every stage."""
    compare: bool = False
    """Also build the mesh from the other sources of points (onnx, onnx+depth, rgbd) and report how they differ."""
    since: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """An earlier scene of the same place: report what moved, appeared, sank or went since then."""
    cache: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Where finished stages are kept (default: REALSIM_CACHE or the user's cache folder)."""
    no_cache: tyro.conf.FlagCreatePairsOff[bool] = False
    """Neither reuse nor keep finished stages."""

    def seeded(self) -> ReconstructConfig:
        """The same with `seed` handed to every stage that has one."""
        return replace(
            self,
            points=replace(self.points, seed=self.seed),
            scale=replace(self.scale, seed=self.seed),
            align=replace(self.align, seed=self.seed),
            mesh=replace(self.mesh, seed=self.seed),
        )


def reconstruct(source: Path, out: Path, config: ReconstructConfig | None = None) -> Reconstruction:
    """Read a capture or scan, find points, metres and the simulation frame, build the mesh, write the checked scene.

    Args:
        source: a folder of frames in any layout of `realsim.capture.LAYOUTS`, or a scan file.
        out: the scene's folder; it appears only when everything in it is complete.
        config: what to do otherwise than by default.

    Returns:
        What every stage found; `scene.folder` is `out`.

    Raises:
        RealsimError: bad input or an impossible request, with file, expectation, finding and way out. Nothing is left
            behind at `out`.
    """
    config = (config or ReconstructConfig()).seeded()
    if config.since is not None:
        changes.check_scene(config.since)
    run = _Run(config)
    with output_folder(out, overwrite=config.overwrite, source=source) as folder:
        data = run.stage("capture", lambda: capture.read(source, config.capture))
        with whole("reconstruct", usual_seconds(data, config)) as run.remaining:
            points, aligned = run.scan(data) if isinstance(data, Scan) else run.frames(data)
            mesh = run.mesh(aligned)
            rivals = run.stage("compare", lambda: run.modes(data, points, aligned, mesh)) if config.compare else ()
            scene = run.export(folder, aligned, mesh)
            result = Reconstruction(
                data, points, aligned, mesh, scene, tuple(run.stages), config.seed, config_as_dict(config), rivals
            )
            if (before := config.since) is not None:
                result = replace(result, changes=run.stage("changes", lambda: changes.since(before, folder)))
            run.stage("report", lambda: report.write_report(folder, result))
    release_memory()
    return replace(result, scene=_moved(scene, out.absolute()), stages=tuple(run.stages))


USUAL = {
    "points": (5.0, 0.24),
    "scale": (0.5, 0.06),
    "align": (1.5, 0.13),
    "mesh": (8.0, 0.17),
    "export": (15.0, 0.0),
    "report": (1.0, 0.0),
}
"""Stage -> seconds, and seconds more for each frame, on two cores, over 60 to 960 rendered frames; a scan has
none. Small captures and the choice of collision geometry: the two captures of the tutorials."""


def usual_seconds(data: FrameSet | Scan, config: ReconstructConfig) -> dict[str, float]:
    """Stage -> seconds that it usually takes, for the time that is left."""
    frames = 0 if isinstance(data, Scan) else len(data)
    usual = {stage: once + each * frames for stage, (once, each) in USUAL.items()}
    if isinstance(data, Scan):
        del usual["points"], usual["scale"]
    elif config.compare:
        usual["compare"] = 2 * (usual["points"] + usual["scale"] + usual["align"] + usual["mesh"])
    return usual


class _Run:
    """Times the stages and reuses what is finished. Keys chain: a stage's key contains that of the one before."""

    def __init__(self, config: ReconstructConfig) -> None:
        self.config = config
        self.stages: list[StageTime] = []
        self.store = StageCache(None if config.no_cache else config.cache or default_folder())
        onnx = replace(config.points.onnx, kept_in=self.store.folder)
        self.config = replace(config, points=replace(config.points, onnx=onnx))
        self.key = ""
        self.remaining = Remaining({})

    def stage(self, name: str, work: Callable[[], T]) -> T:
        return self._timed(name, lambda: (work(), False))

    def scan(self, scan: Scan) -> tuple[None, AlignedScene]:
        """A finished surface enters at `align`."""
        return None, self.align(scan)

    def frames(self, frames: FrameSet) -> tuple[Pointmaps, AlignedScene]:
        points = self.points(frames)
        metric = self.stage("scale", lambda: self.metric(frames, points))
        return points, self.align(metric)

    def points(self, frames: FrameSet) -> Pointmaps:
        config = self.config.points
        code, model = code_digest("capture", "feedforward"), feedforward.inputs(config)
        self.key = digest(code, source_digest(frames), self.config.capture, config, *model)
        solution = self._kept("points", lambda: feedforward.solve(frames, config))
        return feedforward.pointmaps(frames, solution, config)

    def metric(self, frames: FrameSet, points: Pointmaps) -> MetricScene:
        self.key = digest(self.key, code_digest("scale"), self.config.scale)
        return scale.to_metric(points, self.config.scale, frames.up_world, frames.sensor_sigma)

    def align(self, source: MetricScene | Scan) -> AlignedScene:
        if isinstance(source, Scan):
            self.key = digest(code_digest("capture"), source_digest(source))
        self.key = digest(self.key, code_digest("align"), self.config.align)
        # Views and scans are not stored again with what was found from them.
        bare = self._kept("align", lambda: replace(align.align(source, self.config.align), metric=None, scan=None))
        return replace(bare, scan=source) if isinstance(source, Scan) else replace(bare, metric=source)

    def mesh(self, aligned: AlignedScene) -> TerrainMesh:
        self.key = digest(self.key, code_digest("meshing"), self.config.mesh)
        return self._kept("mesh", lambda: meshing.build(aligned, self.config.mesh))

    def export(self, folder: Path, aligned: AlignedScene, mesh: TerrainMesh) -> SceneFiles:
        """The scene in `folder`; of a scene that was checked before, the same files again."""
        config = self.config.scene
        robot = robots.load(config.robot) if config.robot else None
        parts = (robot.spec.to_xml(), sorted(robot.files.items())) if robot else ()
        self.key = digest(self.key, code_digest("export", "robots"), config, *parts)

        def work() -> tuple[SceneFiles, dict[str, Any]]:
            made = write_scene(folder, aligned, mesh, config)
            files = sorted(path for path in folder.rglob("*") if path.is_file())
            return made, {str(f.relative_to(folder)): np.frombuffer(f.read_bytes(), np.uint8) for f in files}

        scene, files = self._kept("export", work)
        for name, data in files.items():
            if not (folder / name).exists():
                write_bytes(inside(folder, name), data.tobytes())
        return _moved(scene, folder)

    def modes(
        self, data: FrameSet | Scan, points: Pointmaps | None, aligned: AlignedScene, mesh: TerrainMesh
    ) -> tuple[Mode, ...]:
        """What was found, and the same from the other sources of points; one that cannot is a row with its reason."""
        if isinstance(data, Scan) or points is None:
            raise RealsimError("a scan has one source of points only", file=data.source, hint="leave out --compare")
        rows = [modes.figures(points, aligned, mesh, sum(s.seconds for s in self.stages))]
        for backend in modes.others(points.backend):
            rival = _Run(replace(self.config, points=replace(self.config.points, backend=backend)))
            try:
                found, scene = rival.frames(data)
                surface = rival.mesh(scene)
            except RealsimError as error:
                rows.append(Mode(backend, error.render()))
                continue
            seconds = sum(s.seconds for s in rival.stages)
            rows.append(modes.figures(found, scene, surface, seconds, delivered=mesh))
        return tuple(rows)

    def _kept(self, name: str, work: Callable[[], T]) -> T:
        return self._timed(name, lambda: self.store.get_or_make(f"{name}-{self.key}", work))

    def _timed(self, name: str, work: Callable[[], tuple[T, bool]]) -> T:
        note(f"{name} ...")
        self.remaining.begin(name)
        began = time.perf_counter()
        release_memory()
        try:
            # Views are worked on in threads; BLAS threads of its own beside them would wait in loops for each other.
            with threadpool_limits(1, user_api="blas"):
                value, reused = work()
        except MemoryError as error:
            raise RealsimError(
                f"out of memory in stage {name}", hint="use fewer frames (--max-frames) or a coarser --resolution"
            ) from error
        self.remaining.end(kept=reused)
        seconds = time.perf_counter() - began
        self.stages.append(StageTime(name, seconds, peak_memory_mb(), reused))
        note(f"{name}: {seconds:.1f} s{' (kept from an earlier run)' if reused else ''}")
        return value


def release_memory() -> None:
    """Give freed memory back to the system where the C library would keep it (glibc); elsewhere nothing happens.

    What threads freed stays with their arenas: on a corridor of 145 frames half of what a stage held. Within a stage
    it is kept instead: an array of megabytes that is given back and taken anew is cleared anew by the system.
    """
    with suppress(OSError, AttributeError):
        libc = ctypes.CDLL("libc.so.6")
        libc.malloc_trim(0)
        libc.mallopt(M_TRIM_THRESHOLD, 1 << 30)
        libc.mallopt(M_MMAP_THRESHOLD, 1 << 25)
        libc.mallopt(M_ARENA_MAX, 1)


M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
"""Of glibc's malloc.h."""


def peak_memory_mb() -> float:
    """Peak resident memory of this process so far, MB."""
    try:
        # getrusage's figure would begin with the peak of the process that started this one.
        status = Path("/proc/self/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) * 1.024e-3
    except (OSError, IndexError, ValueError):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1e6 if sys.platform == "darwin" else 1e3)


def config_as_dict(config: Any) -> dict[str, Any]:
    """A configuration as JSON-able values; paths as text."""
    return json.loads(json.dumps(dataclasses.asdict(config), default=str))


def _moved(scene: SceneFiles, folder: Path) -> SceneFiles:
    def at(path: Path) -> Path:
        return folder / path.relative_to(scene.folder)

    return replace(
        scene,
        folder=folder,
        scene_xml=at(scene.scene_xml),
        mesh_ply=at(scene.mesh_ply),
        mesh_glb=at(scene.mesh_glb),
    )
