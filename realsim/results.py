"""Results of the top-level functions: small frozen dataclasses and enums, each with a short repr and a notebook view.

A `Scene` and a `Diagnosis` are also read back from disk (`load_scene`, `load_diagnosis`), so that what a script gets
from a run of its own and what it finds in a folder have one type.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import RealsimError
from realsim.core.files import edited_files, read_json
from realsim.core.notebook import bars, table
from realsim.core.statistics import Interval
from realsim.gap.verdicts import GapVerdict

__all__ = [
    "Cause",
    "Contact",
    "Diagnosis",
    "GapVerdict",
    "Interval",
    "Place",
    "Rest",
    "Scene",
    "SceneVerdict",
    "Shrinkage",
    "Site",
]


class SceneVerdict(StrEnum):
    """Whether a scene can be used; the worst of the report's checks."""

    GOOD = "good"
    LOOK = "look"
    BAD = "bad"

    @property
    def usable(self) -> bool:
        """False where the report says not to train or test on the scene."""
        return self is not SceneVerdict.BAD


# ---------------------------------------------------------------- scenes


@dataclass(frozen=True)
class Site:
    """The start or goal platform of a scene, simulation frame."""

    center: tuple[float, float, float]
    """Centre of the top face, metres."""
    size: tuple[float, float, float]
    """Along the long side, across it, and the height above the ground, metres."""
    yaw: float
    """Direction of the long side about z, radians."""


@dataclass(frozen=True)
class Contact:
    """Measured error of contact in the simulator against the mesh."""

    representation: str
    geoms: int
    median_mm: float
    p95_mm: float
    phantom_cm2: float
    """Area with contact but without surface of the mesh."""
    missing_cm2: float
    """Area of the mesh without contact."""
    leaks: int
    """Number of objects that fall through."""


@dataclass(frozen=True, repr=False)
class Scene:
    """A scene folder that MuJoCo opens, with what was measured about it."""

    folder: Path
    contact: Contact
    verdict: SceneVerdict | None = None
    """Of the whole scene, or of the contact geometry alone for a scene of `contact`."""
    headline: str = ""
    """The verdict as a sentence."""
    reasons: tuple[str, ...] = ()
    """Why the verdict is not better, the worst first."""
    next_steps: tuple[str, ...] = ()
    """What to do about the reasons."""
    scale: Interval | None = None
    """Factor from the capture's units to metres; None for a mesh."""
    start: Site | None = None
    goal: Site | None = None
    frames_used: int = 0
    frames_dropped: Mapping[str, str] = field(default_factory=dict)
    """Name of a frame -> why it was left out."""
    warnings: tuple[str, ...] = ()
    edited: tuple[str, ...] = ()
    """Files that were changed or removed since the report was written: its figures are not theirs."""
    report: Mapping[str, Any] = field(default_factory=dict)
    """All of report.json (or contact.json)."""
    details: Any = None
    """`realsim.core.types.Reconstruction` of the run that made the scene: arrays of every stage. None if read from
    disk."""

    @property
    def scene_xml(self) -> Path:
        """The MuJoCo model."""
        return self.folder / "scene.xml"

    @property
    def page(self) -> Path | None:
        """The report for a browser, where there is one."""
        path = self.folder / "report.html"
        return path if path.is_file() else None

    def spec(self) -> Any:
        """The scene as a new `mujoco.MjSpec`, to add to. Raises ExportError where it is damaged."""
        import mujoco

        from realsim.export.formats.scene import compile_scene

        return compile_scene(self.folder, mujoco.MjSpec.from_file)

    def model(self) -> Any:
        """The scene as a compiled `mujoco.MjModel`. Raises ExportError where it is damaged."""
        import mujoco

        from realsim.export.formats.scene import compile_scene

        return compile_scene(self.folder, mujoco.MjModel.from_xml_path)

    def geometry(self) -> Any:
        """Mesh, collision geometry and platforms as arrays (`realsim.export.formats.SceneOnDisk`)."""
        from realsim.export.formats import load_scene

        return load_scene(self.folder)

    def export(self, to: str | Sequence[str] = "all", out: Path | str | None = None, *, overwrite: bool = False) -> Any:
        """Write the scene in the formats of other tools: `realsim.export` with this scene.

        Returns:
            `realsim.export.Exported`: a dictionary {format: files written}.
        """
        from realsim.export import export_scene

        return export_scene(self.folder, to, None if out is None else Path(out), overwrite=overwrite)

    @classmethod
    def read(cls, folder: Path, details: Any = None) -> Scene:
        """Read a folder that `reconstruct` or `contact` wrote. Raises RealsimError where it is none."""
        folder = Path(folder)
        names = [name for name in ("report.json", "contact.json") if (folder / name).is_file()]
        if not names or not (folder / "scene.xml").is_file():
            raise RealsimError(
                "not a scene folder",
                file=folder,
                expected="scene.xml with report.json or contact.json, as realsim writes them",
                hint="realsim reconstruct FRAMES --out DIR, or realsim contact MESH --out DIR",
            )
        data = read_json(folder / names[0])
        try:
            return _scene(cls, folder, data, data["contact"] if names[0] == "report.json" else data, details)
        except (KeyError, TypeError, ValueError) as error:
            raise RealsimError(
                "the report of this scene cannot be read",
                file=folder / names[0],
                found=f"{type(error).__name__}: {error}",
                hint="make the scene again with this version of realsim",
            ) from error

    def __repr__(self) -> str:
        verdict = f"verdict={self.verdict.value}, " if self.verdict else ""
        c = self.contact
        return f"Scene({str(self.folder)!r}, {verdict}contact={c.representation} {c.median_mm:.1f}/{c.p95_mm:.1f} mm)"

    def _repr_html_(self) -> str:
        c = self.contact
        rows = [
            ("verdict", f"{self.verdict.value}: {self.headline}" if self.verdict else "only contact is measured"),
            *(("", reason) for reason in self.reasons[:5]),
            ("scale", str(self.scale) if self.scale else ""),
            ("goal", "" if self.goal is None else ", ".join(f"{v:.2f}" for v in self.goal.center) + " m"),
            ("contact", f"{c.representation}, {c.median_mm:.1f} mm median, {c.p95_mm:.1f} mm at the 95th percentile"),
            ("files", str(self.folder)),
        ]
        return f"<div>{_height_picture(self.folder / 'mesh.ply')}{table(rows)}</div>"


def _scene(kind: type[Scene], folder: Path, data: Any, contact: Any, details: Any) -> Scene:
    verdict = data.get("verdict") or {}
    scale, frames = data.get("scale"), data.get("frames") or {}
    edited = edited_files(folder, data.get("files"))
    level = verdict.get("level")
    return kind(
        folder=folder,
        contact=Contact(
            str(contact["representation"]),
            sum(contact["geoms"].values()),
            float(contact["median_mm"]),
            float(contact["p95_mm"]),
            float(contact["phantom_area_cm2"]),
            float(contact["missing_area_cm2"]),
            int(contact["leaks"]),
        ),
        verdict=SceneVerdict(level) if level else None,
        headline=str(verdict.get("headline", "")),
        reasons=tuple(verdict.get("reasons", ())),
        next_steps=tuple(verdict.get("next", ())),
        scale=Interval(scale["value"], *scale["ci90"]) if scale else None,
        start=_site(data.get("start")),
        goal=_site(data.get("goal")),
        frames_used=len(frames.get("used", ())),
        frames_dropped={d["name"]: d["reason"] for d in frames.get("dropped", ())},
        warnings=(*data.get("warnings", ()), *([describe_edited(edited)] if edited else [])),
        edited=edited,
        report=data,
        details=details,
    )


def describe_edited(names: Sequence[str]) -> str:
    """A warning about files of a scene that are no longer those of its report."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"{', '.join(names[:3])}{more}: changed since the report was written, whose figures are of what was there"


def _site(data: Mapping[str, Any] | None) -> Site | None:
    if data is None:
        return None
    (x, y, z), (long, across, height) = data["centroid"], data["size"]
    return Site((x, y, z), (long, across, height), float(data["yaw"]))


def _height_picture(mesh_ply: Path, cells: int = 360) -> str:
    """The surface from above as an <img>, coloured by height; a sentence where it cannot be drawn."""
    from realsim.report import raster

    if not mesh_ply.is_file():
        return ""
    import trimesh

    try:
        mesh: Any = trimesh.load(mesh_ply, process=False, force="mesh")
        mesh.update_faces(np.isfinite(mesh.triangles).all((1, 2)))
    except Exception as error:  # readers of broken files raise whatever comes up; a notebook shows the rest
        return f"<p>mesh.ply cannot be read: {escape(f'{type(error).__name__}: {error}')}</p>"
    if not mesh.area > 0:
        return "<p>mesh.ply holds no surface</p>"
    low, high = mesh.bounds[:, :2]
    step = max(float((high - low).max()) / cells, 1e-9)
    # Eight samples a cell leave one cell in 3000 empty by chance.
    points, _ = trimesh.sample.sample_surface(mesh, min(int(8 * mesh.area / step**2) + 1, 5_000_000), seed=0)
    column, row = ((points[:, :2] - low) / step).astype(int).T
    grid = np.full((row.max() + 1, column.max() + 1), -np.inf)
    np.maximum.at(grid, (row, column), points[:, 2])
    grid[np.isinf(grid)] = np.nan
    bottom, top = (float(v) for v in np.nanpercentile(grid, [0.5, 99.5]))
    uri = raster.png_uri(raster.colorize(grid[::-1], bottom, top))
    return f'<img src="{uri}" alt="height from above, {bottom:.2f} to {top:.2f} m" style="max-width:540px;width:100%">'


# ---------------------------------------------------------------- diagnoses


@dataclass(frozen=True)
class Cause:
    """An unmodelled effect at its place, with its size."""

    effect: str
    places: tuple[str, ...]
    """Joints, bodies or pieces of terrain; empty where the effect acts everywhere."""
    parameters: Mapping[str, Interval]
    probability: float | None = None

    def __str__(self) -> str:
        sizes = ", ".join(f"{name} {value}" for name, value in self.parameters.items())
        return f"{self.effect}{' at ' + ', '.join(self.places) if self.places else ''}: {sizes}"


@dataclass(frozen=True)
class Place:
    """A place where robot and simulator differ, with its share of the squared error."""

    signal: str
    joint: str | None
    phase: str | None
    share: float


@dataclass(frozen=True)
class Shrinkage:
    """Share of the squared error that the causes remove on some runs."""

    fraction: float
    low: float
    high: float
    """90 percent interval of `fraction`."""
    runs: tuple[str, ...]
    held_out: bool
    """Whether nothing was fitted to these runs; the verdict is decided with them, so they are a validation."""


@dataclass(frozen=True)
class Rest:
    """Root mean square errors of a signal, in its unit, beside the size of the motion."""

    signal: str
    unit: str
    motion: float
    before: float
    """Of the nominal simulator."""
    after: float
    """With the causes."""


NAMING = (GapVerdict.IDENTIFIED, GapVerdict.AMBIGUOUS, GapVerdict.PARTLY_EXPLAINED)
"""Verdicts that name a cause."""


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Location, causes and size of the sim-to-real gap, and a patch."""

    verdict: GapVerdict
    sentence: str
    causes: tuple[Cause, ...]
    equivalent: tuple[tuple[Cause, ...], ...]
    """Other sets of causes that explain the runs as well."""
    where: tuple[Place, ...]
    shrinkage: Shrinkage
    unexplained_share: float
    """Share of the gap above the noise floor that stays there beside causes and everyday deviations."""
    patch: Mapping[str, Any]
    """For `apply_patch`."""
    stays: tuple[Rest, ...] = ()
    """Errors of the patched simulator on the runs of the check, by signal."""
    advice: str = ""
    """What to do about it: one thing."""
    looks_like: tuple[str, ...] = ()
    """What stays, in words: `friction-like at left_knee`."""
    warnings: tuple[str, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    """All of diagnosis.json."""
    folder: Path | None = None
    """Where diagnosis.json, model.xml and report.html are; None if nothing was written."""

    @classmethod
    def of(cls, data: Mapping[str, Any], folder: Path | None = None) -> Diagnosis:
        """From the content of diagnosis.json. Raises RealsimError where it has another form."""
        try:
            if data["verdict"] in NAMING and not data["causes"]:
                raise ValueError(f"verdict {data['verdict']}, but no cause")
            s = data["shrinkage"]
            low, high = (_number(v) for v in s["ci90"])
            return cls(
                verdict=GapVerdict(data["verdict"]),
                sentence=str(data["sentence"]),
                causes=tuple(_cause(c) for c in data["causes"]),
                equivalent=tuple(tuple(_cause(c) for c in group) for group in data["equivalent"]),
                where=tuple(
                    Place(w["signal"], w.get("joint"), w.get("phase"), float(w["share"])) for w in data["where"]
                ),
                shrinkage=Shrinkage(_number(s["fraction"]), low, high, tuple(s["runs"]), bool(s["unseen"])),
                unexplained_share=_number(data["unexplained_share"]),
                patch=data["patch"],
                stays=tuple(
                    Rest(name, v["unit"], *(_number(v[k]) for k in ("motion", "rms_before", "rms_after")))
                    for name, v in s.get("per_signal", {}).items()
                    if "motion" in v  # 0.1.0 had none
                ),
                advice=str(data.get("advice", "")),
                looks_like=tuple(f"{entry['what']} at {entry['joint']}" for entry in data.get("looks_like", ())),
                warnings=tuple(data["health"]["warnings"]),
                data=data,
                folder=folder,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise RealsimError(
                "not a diagnosis of this version",
                file=folder,
                found=f"{type(error).__name__}: {error}",
                hint="run realsim diagnose again",
            ) from error

    @property
    def page(self) -> Path | None:
        """The report for a browser, where one was written."""
        path = None if self.folder is None else self.folder / "report.html"
        return path if path is not None and path.is_file() else None

    def __repr__(self) -> str:
        causes = "; ".join(str(c) for c in self.causes) or "none"
        return f"Diagnosis({self.verdict.value}, causes: {causes})"

    def _repr_html_(self) -> str:
        s = self.shrinkage
        rows = [
            ("verdict", self.verdict.value),
            *(("cause" if i == 0 else "", str(cause)) for i, cause in enumerate(self.causes)),
            *(("error", f"{r.signal} {r.before:.2g} to {r.after:.2g} {r.unit} rms") for r in self.stays),
            ("next", self.advice),
            ("removes", f"{100 * s.fraction:.0f} % [{100 * s.low:.0f}, {100 * s.high:.0f}] of the squared error"),
            ("files", str(self.folder) if self.folder else ""),
        ]
        shares = [(f"{w.signal} {w.joint or ''} {w.phase or ''}", w.share) for w in self.where[:6]]
        return f"<div><p>{escape(self.sentence)}</p>{bars(shares)}{table(rows)}</div>"


def _cause(data: Mapping[str, Any]) -> Cause:
    parameters = {}
    for name, p in data["parameters"].items():
        low, high = (_number(v) for v in p["ci90"])
        parameters[name] = Interval(_number(p["value"]), low, high, p["unit"])
    places = tuple(n for key in ("joints", "bodies", "actuators") for n in data.get(key) or ())
    return Cause(str(data["effect"]), places, parameters, data.get("probability"))


def _number(value: float | None) -> float:
    """JSON has no NaN: it is null there."""
    return float("nan") if value is None else float(value)
