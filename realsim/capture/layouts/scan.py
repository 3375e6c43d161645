"""A finished surface (a LiDAR cloud, a phone's mesh, one made by hand), which enters the pipeline at `align`."""

from pathlib import Path

import numpy as np

from realsim.capture.config import UNITS, CaptureConfig
from realsim.capture.layout import Layout, Recognition
from realsim.capture.listing import list_files, single_file
from realsim.capture.recognition import LAST_RESORT
from realsim.capture.scanfile import READERS, RawScan, read_scan
from realsim.capture.standpoint import stood_at
from realsim.core.errors import CaptureError
from realsim.core.meshes import areas, local_origin, lonely_vertex, loose_vertices, lost_precision, origin_note
from realsim.core.types import F64, Bool, Scan

SUFFIXES = tuple(READERS)
PLAUSIBLE_EXTENT = (0.2, 100.0)
"""Metres: how long a terrain with its surroundings can be. Beyond, the unit is wrong, or it is a map."""
USUAL_EXTENT = (0.5, 30.0)
FLAT = 1e-12
"""Area of a mesh for the square of its size, below which it is a line: what rounding leaves."""
SMALLEST = float(np.finfo(np.float32).tiny)
"""Smaller than single precision keeps: such numbers come of damaged bits, not of programs."""
METRES = (".las", ".laz", ".pcd")
"""Formats whose unit is the metre: laser scanners and robots write no other."""


def recognise(path: Path) -> Recognition:
    found = single_file(path, SUFFIXES)
    if found is not None:
        # Lowest of all: captures often come with the mesh that the phone made of them.
        return Recognition((found.name,), (), score=LAST_RESORT)
    several = [p.name for p in list_files(path, SUFFIXES)]
    if not several:
        return Recognition()
    return Recognition(
        (f"{len(several)} scan files",), (f"single scan file (name one: {', '.join(several[:4])})",), LAST_RESORT
    )


def read(path: Path, config: CaptureConfig) -> Scan:
    source = single_file(path, SUFFIXES)
    if source is None:
        raise CaptureError("no scan", file=path, expected=f"one file {', '.join(SUFFIXES)}, or a folder that holds one")
    raw, warnings = _checked(read_scan(source), source)
    points = raw.points * UNITS[config.unit]
    origin = local_origin(points)
    unusual = check_extent(points, config.unit, source, surveyed=bool(origin.any()))
    if lost := lost_precision(source, raw.points, UNITS[config.unit]):
        raise CaptureError(
            "the coordinates have lost their precision",
            file=source,
            expected="a local origin, or double precision",
            found=lost,
            hint="subtract an offset where the scan is exported",
        )
    points = points - origin
    if raw.triangles is not None and (
        len(points) < 4 or areas(points, raw.triangles).sum() < FLAT * np.ptp(points) ** 2
    ):
        found = f"{len(raw.triangles)} triangles of {len(points)} vertices"
        raise CaptureError(
            "the mesh has no surface to stand on", file=source, expected="triangles with an area", found=found
        )
    count = 0 if raw.triangles is None else int((raw.triangles == np.roll(raw.triangles, 1, axis=1)).any(axis=1).sum())
    # As some programs write them, and as damage does.
    flat = [f"{count} triangles name a vertex twice: they have no area"] if count else []
    shape = "a cloud" if raw.triangles is None else "a mesh"
    assumptions = [
        f"{shape} in {config.unit}{'' if config.unit == 'm' else ', as requested'}: "
        f"{np.ptp(points, axis=0)[0]:.3g} x {np.ptp(points, axis=0)[1]:.3g} x {np.ptp(points, axis=0)[2]:.3g} m",
        *raw.notes,
        *([origin_note(origin)] if origin.any() else []),
        *flat,
    ]
    if raw.up is None:
        assumptions.append("the file does not say which way is up")
    local = raw.triangles is None and not origin.any()
    sensor = np.zeros(3) if local and stood_at(points, np.zeros(3)) else None
    if sensor is not None:
        assumptions.append("the scanner stood at the origin: from there no point hides behind another")
    return Scan(
        path,
        LAYOUT.name,
        points,
        raw.triangles,
        raw.normals,
        raw.colors,
        sensor_position=sensor,
        up_world=None if raw.up is None else np.array(raw.up),
        assumptions=tuple(assumptions),
        warnings=(*raw.warnings, *warnings, *([unusual] if unusual else [])),
    )


def check_extent(points: F64, unit: str, source: Path, *, surveyed: bool = False) -> str | None:
    """A warning where the size is unusual, None where it is not.

    Args:
        points: (M, 3) metres, with `unit` applied.
        surveyed: whether they are coordinates of a map, which are in metres.

    Raises:
        CaptureError: no terrain is of this size; names the units under which it would be usual.
    """
    # A few stray points far away must not decide.
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    extent = float((high - low).max())
    likely = [name for name, metres in UNITS.items() if _within(extent / UNITS[unit] * metres, USUAL_EXTENT)]
    if _within(extent, PLAUSIBLE_EXTENT):
        if unit in likely:
            return None
        return f"the scan is {extent:.3g} m long: unusual, check the unit (--unit)"
    hint = "crop the scan to the terrain"
    if likely and not surveyed and source.suffix.lower() not in METRES:
        hint = f"pass --unit {' or --unit '.join(likely)}"
    raise CaptureError(
        "the scan is of an implausible size",
        file=source,
        expected=f"a terrain {PLAUSIBLE_EXTENT[0]:g} to {PLAUSIBLE_EXTENT[1]:g} m long",
        found=f"{extent:.4g} m with the unit {unit}",
        hint=hint,
    )


def _checked(raw: RawScan, source: Path) -> tuple[RawScan, list[str]]:
    """Without NaN and infinity, normals of length 1; a warning for what was left out.

    Raises:
        CaptureError: empty, or triangles that refer to points that are not there.
    """
    if not len(raw.points) or (raw.triangles is not None and not len(raw.triangles)):
        raise CaptureError("the scan is empty", file=source, expected="points or triangles")
    if raw.triangles is not None and not (raw.triangles.min() >= 0 and raw.triangles.max() < len(raw.points)):
        raise CaptureError("triangles refer to missing points", file=source)
    usual = (np.abs(raw.points) >= SMALLEST) | (raw.points == 0)
    finite: Bool = (usual & np.isfinite(raw.points)).all(axis=1)
    if raw.triangles is not None and not finite.all():
        raise CaptureError(
            "vertices of the mesh are no places: the file is damaged",
            file=source,
            expected=f"{len(finite)} vertices of finite coordinates, each 0 or not below {SMALLEST:.1e} in size",
            found=f"{finite.sum()}; the first other is {raw.points[~finite][0].tolist()}",
            hint="export it again, or mend it in a mesh editor",
        )
    if not finite.any():
        raise CaptureError(
            "no point of the scan has finite coordinates", file=source, found=f"{len(finite)} with NaN or infinity"
        )
    warnings = []
    triangles = raw.triangles
    if triangles is not None and (loose := loose_vertices(len(raw.points), triangles)):
        warnings.append(loose)
    if alone := lonely_vertex(raw.points[finite]):
        warnings.append(alone)
    if triangles is None and source.suffix.lower() == ".obj":
        warnings.append("the file has no faces and is taken as a cloud: is it cut off?")
    if not finite.all():
        warnings.append(f"{(~finite).sum()} of {len(finite)} points are NaN, infinite or damaged and left out")
    normals = raw.normals
    if normals is not None:
        lengths = np.linalg.norm(normals[finite], axis=1)
        usable = bool(np.isfinite(lengths).all() and (lengths > 1e-6).all())
        if not usable:
            warnings.append("some normals are zero or NaN: normals are not used")
        normals = normals[finite] / lengths[:, None] if usable else None
    colors = None if raw.colors is None else raw.colors[finite]
    return RawScan(raw.points[finite], triangles, normals, colors, raw.up, raw.notes, raw.warnings), warnings


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


LAYOUT = Layout("scan", f"one finished scan: {', '.join(SUFFIXES)}", recognise, read)
