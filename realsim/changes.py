"""What changed between two reconstructions of one place: what appeared, went, moved, sank or rose.

    changes = compare(load_scene(before), load_scene(after))

Both surfaces are laid over one another (features of shape, then iterative closest points on what agrees), and their
heights are compared on a grid. A cell counts only where both scans saw it, and where the height today lies beyond all
heights around it before: an edge that is a centimetre off is no change.
"""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import RealsimError
from realsim.core.files import read_bytes
from realsim.core.geometry import invert_T, transform
from realsim.core.meshes import across, areas, sampled
from realsim.core.rays import heights
from realsim.core.types import F64, Bool

CELL = 0.005
"""Metres of the grid."""
MOST_CELLS = 4_000_000
SLACK = 0.015
"""Metres by which an edge may lie elsewhere: surfaces are rounded, and laid over one another to some millimetres."""
LEAST = 0.03
"""Metres, smallest size of an object and of a change that is told."""
HEIGHT = 0.015
"""Metres of height that are a change, at least; three times the scans' own disagreement where that is more."""
FLUSH = 0.015
"""Metres within which a place is as high as what surrounds it."""
SURE = 0.8
"""Share from which no other way to lay them over one another is tried."""
OVERLAP = 0.4
"""Share of the smaller surface that has to lie on the other one, for both to be one place."""


@dataclass(frozen=True)
class Change:
    """One object that is otherwise than before; simulation frame of today's scene."""

    kind: str
    """appeared, went, moved, sank or rose."""
    center: F64
    """(3,) metres, middle of its top today; of what went, before."""
    size: F64
    """(3,) metres: along, across, and its height over what surrounds it."""
    shift: F64
    """(3,) metres from before to today; zero for what appeared or went."""

    def text(self) -> str:
        """In words."""
        x, y, z = self.center
        along, across, height = 100 * self.size
        what = f"{along:.0f} x {across:.0f} x {height:.0f} cm at {x:.2f} {y:.2f} {z:.2f}"
        if self.kind in ("sank", "rose"):
            return f"{what} {self.kind} by {100 * abs(self.shift[2]):.0f} cm"
        if self.kind == "moved":
            return (
                f"{what} moved by {100 * np.linalg.norm(self.shift):.0f} cm ({self.shift[0]:+.2f} {self.shift[1]:+.2f})"
            )
        return f"{what} {self.kind}"

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "kind": self.kind,
            "center": self.center.round(4).tolist(),
            "size": self.size.round(4).tolist(),
            "shift": self.shift.round(4).tolist(),
        }


@dataclass(frozen=True)
class Changes:
    """All that is otherwise, and how well the two scans agree elsewhere."""

    objects: tuple[Change, ...]
    T_today_before: F64
    """(4, 4) from the simulation frame of the scene before to today's."""
    compared_m2: float
    """Ground that both scans saw."""
    noise_m: float
    """Median difference of heights where nothing changed."""

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "objects": [change.as_dict() for change in self.objects],
            "T_today_before": self.T_today_before.tolist(),
            "compared_m2": self.compared_m2,
            "noise_m": self.noise_m,
        }


Surface = tuple[F64, NDArray[np.int32]]
"""(V, 3) metres with z up, and (K, 3)."""


def compare(before: Surface, today: Surface) -> Changes:
    """Compare two surfaces of one place, each in a levelled frame of its own.

    Raises:
        RealsimError: they cannot be laid over one another.
    """
    T = lay_over(before, today)
    low, high = today[0][:, :2].min(0), today[0][:, :2].max(0)
    cell = max(CELL, float(np.sqrt(np.prod(high - low) / MOST_CELLS)))
    old, new = (heights(*s, low, high, cell) for s in ((transform(T, before[0]), before[1]), today))
    both = np.isfinite(old) & np.isfinite(new)
    if not both.any():
        raise RealsimError("the two scans have no ground in common", hint="is it the same place?")
    off = (new - old)[both]
    new = new - np.median(off)  # centimetres of level that registration leaves are no change of everything
    noise = 1.4826 * float(np.median(np.abs(off - np.median(off))))
    limit = max(HEIGHT, 3 * noise)
    reach = int(np.ceil(SLACK / cell))
    raised = both & (new > _around(old, reach, np.fmax) + limit)
    lowered = both & (new < _around(old, reach, np.fmin) - limit)
    pieces = {kind: _pieces(mask, cell) for kind, mask in (("raised", raised), ("lowered", lowered))}
    found = _changes_of(pieces["raised"], pieces["lowered"], old, new, low, cell)
    return Changes(tuple(found), T, float(both.sum() * cell**2), noise)


def lay_over(before: Surface, today: Surface) -> F64:
    """(4, 4) that takes `before` to `today`: the best of their frames as they are and of matched shapes, each refined.

    Raises:
        RealsimError: less than OVERLAP of the smaller one lies on the other.
    """
    from realsim.core.open3d import o3d

    registration: Any = o3d.pipelines.registration  # its stubs lag behind the library
    rng = np.random.default_rng(0)
    clouds = [_cloud(surface, rng) for surface in (before, today)]
    coarse = [c.voxel_down_sample(0.05) for c in clouds]
    near = o3d.geometry.KDTreeSearchParamHybrid(0.25, 100)
    features = [registration.compute_fpfh_feature(c, near) for c in coarse]

    def by_shapes() -> F64:
        o3d.utility.random.seed(0)
        found = registration.registration_ransac_based_on_feature_matching(
            *coarse,
            *features,
            True,
            0.08,
            checkers=[
                registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                registration.CorrespondenceCheckerBasedOnDistance(0.08),
            ],
            criteria=registration.RANSACConvergenceCriteria(50_000, 0.999),
        )
        return np.asarray(found.transformation)

    best, share = np.eye(4), 0.0
    for start in (lambda: np.eye(4), by_shapes):
        if share > SURE:
            break
        T = start()
        for distance in (0.15, 0.05, 0.02):
            kernel = registration.TukeyLoss(distance / 2)
            step = registration.registration_icp(
                *clouds, distance, T, registration.TransformationEstimationPointToPlane(kernel)
            )
            T = np.asarray(step.transformation)
        back = registration.evaluate_registration(clouds[1], clouds[0], 0.02, invert_T(T)).fitness
        on = max(registration.evaluate_registration(*clouds, 0.02, T).fitness, back)
        if on > share:
            best, share = T, on
    if share < OVERLAP:
        raise RealsimError(
            "the two scans cannot be laid over one another",
            expected=f"at least {OVERLAP:.0%} of one within 2 cm of the other",
            found=f"{share:.0%}",
            hint="is it the same place? Scan more of what has not changed",
        )
    return best


def _cloud(surface: Surface, rng: np.random.Generator, spacing: float = 0.02) -> Any:
    """Points with normals, even over the surface."""
    from realsim.core.open3d import o3d

    count = int(np.clip(areas(*surface).sum() / spacing**2, 2000, 200_000))
    points, face = sampled(*surface, count, rng)
    normals = across(surface[0], surface[1][face])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    return cloud


def _around(z: F64, reach: int, extreme: np.ufunc) -> F64:
    """The extreme (fmax or fmin) of the heights within `reach` cells of each, NaN left out."""
    from scipy import ndimage

    filter_, none = (ndimage.maximum_filter, -np.inf) if extreme is np.fmax else (ndimage.minimum_filter, np.inf)
    out = filter_(np.where(np.isfinite(z), z, none), 2 * reach + 1, mode="constant", cval=none)
    return np.where(np.isfinite(out), out, np.nan)


def _pieces(mask: Bool, cell: float) -> list[Bool]:
    """The connected parts of a mask that are LEAST long and, less what their edges lose to SLACK, wide."""
    from scipy import ndimage

    labels, _ = ndimage.label(mask)
    out = []
    for k, box in enumerate(ndimage.find_objects(labels), 1):
        part = np.pad(labels[box] == k, 1)
        if part.sum() * cell**2 < LEAST**2 / 3 or max(part.shape) * cell < LEAST / 2:
            continue
        if 2 * float(ndimage.distance_transform_edt(part).max()) * cell >= LEAST / 3:
            out.append(labels == k)
    return out


def _changes_of(raised: list[Bool], lowered: list[Bool], old: F64, new: F64, low: F64, cell: float) -> list[Change]:
    """The changes that the pieces are: those of one shape that are raised here and lowered there are one that moved."""
    out: list[Change] = []
    gone: list[Any] = []
    come: list[Any] = []
    for pieces, here, there, kinds, rest in (
        (lowered, new, old, "sank", gone),
        (raised, old, new, "rose", come),
    ):
        for piece in pieces:
            # What is left stands out of its surroundings still, or already: it changed its height where it is.
            out_of = float(np.nanmedian(here[piece])) - _ring(here, piece, cell)
            thing = _thing(there, piece)
            same = _thing(here, piece)
            if abs(out_of) > FLUSH and np.logical_and(thing, same).sum() > 0.6 * np.logical_or(thing, same).sum():
                by = float(np.nanmedian((new - old)[piece]))
                out.append(_change(kinds, new, thing, low, cell, np.array([0, 0, by])))
            else:
                rest.append(thing)
    for thing in list(come):
        twins = [
            (abs(np.log(g.sum() / thing.sum())) + 20 * abs(_height(new, thing, cell) - _height(old, g, cell)), k)
            for k, g in enumerate(gone)
        ]
        if twins and min(twins)[0] < 0.7:
            before = gone.pop(min(twins)[1])
            shift = _middle(new, thing, low, cell) - _middle(old, before, low, cell)
            out.append(_change("moved", new, thing, low, cell, shift))
        else:
            out.append(_change("appeared", new, thing, low, cell, np.zeros(3)))
    out += [_change("went", old, thing, low, cell, np.zeros(3)) for thing in gone]
    return [c for c in out if c.size[0] >= LEAST and c.size[1] >= LEAST / 2 and c.size[2] >= 0.8 * LEAST]


def _thing(z: F64, piece: Bool) -> Bool:
    """The level neighbourhood of a piece: all of a top of which only a part changed."""
    from scipy import ndimage

    level = float(np.nanmedian(z[piece]))
    labels, _ = ndimage.label((np.abs(z - level) < 2 * FLUSH) | piece)
    own = labels == np.bincount(labels[piece]).argmax()
    return own if own.sum() < 12 * piece.sum() else piece


def _ring(z: F64, piece: Bool, cell: float) -> float:
    """Median height about a piece, from two to five centimetres off."""
    from scipy import ndimage

    near = ndimage.binary_dilation(piece, iterations=int(0.02 / cell))
    ring = ndimage.binary_dilation(near, iterations=int(0.03 / cell)) & ~near & np.isfinite(z)
    return float(np.median(z[ring])) if ring.any() else float(np.nanmedian(z[piece]))


def _height(z: F64, thing: Bool, cell: float) -> float:
    return float(np.nanpercentile(z[thing], 80)) - _ring(z, thing, cell)  # of a small thing half is its rounded edge


def _middle(z: F64, thing: Bool, low: F64, cell: float) -> F64:
    rows, columns = np.nonzero(thing)
    return np.array([*(low + cell * (np.array([columns.mean(), rows.mean()]) + 0.5)), float(np.nanmedian(z[thing]))])


def _change(kind: str, z: F64, thing: Bool, low: F64, cell: float, shift: F64) -> Change:
    import cv2

    rows, columns = np.nonzero(thing)
    _, (a, b), _ = cv2.minAreaRect(np.column_stack([columns, rows]).astype(np.float32))
    along, across = sorted(((a + 1) * cell, (b + 1) * cell), reverse=True)
    return Change(kind, _middle(z, thing, low, cell), np.array([along, across, _height(z, thing, cell)]), shift)


def since(before: Path, today: Path) -> dict[str, Any]:
    """The changes between two scene folders, JSON-able, `text` of each in words."""
    changes = compare(_surface(before), _surface(today))
    objects = [change.as_dict() | {"text": change.text()} for change in changes.objects]
    return {"since": str(before), **changes.as_dict(), "objects": objects}


def check_scene(folder: Path) -> None:
    """Refuse a folder that is no scene, before hours are spent on what is compared with it."""
    _surface(folder)


def _surface(folder: Path) -> Surface:
    import trimesh

    path = folder / "mesh.ply"
    if not path.is_file():
        raise RealsimError(
            "not a scene folder", file=folder, expected="mesh.ply", hint="give the folder of an earlier reconstruct"
        )
    try:
        mesh: Any = trimesh.load(io.BytesIO(read_bytes(path)), file_type="ply", process=False, force="mesh")
    except Exception as error:  # readers of broken files raise whatever comes up
        raise RealsimError("the mesh cannot be read", file=path, expected="a PLY mesh", found=str(error)) from error
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)
