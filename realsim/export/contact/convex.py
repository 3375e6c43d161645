"""`convex`: approximate convex decomposition (CoACD) of every solid that stands on the ground."""

from collections.abc import Iterable

import numpy as np

from realsim.core.types import F64
from realsim.export.config import SceneConfig
from realsim.export.contact.base import Asset, ContactModel, Geom, UnsuitedError
from realsim.export.contact.islands import Island, Terrain
from realsim.export.contact.prisms import as_contact
from realsim.export.contact.shape import COARSE, Shape
from realsim.export.contact.solids import island_solid

OVERLAP = 0.0005  # metres by which parts are grown, so that nothing slips between them


def check_columns(whole: Terrain, islands: Iterable[Island], config: SceneConfig) -> None:
    """Refuse before the time is spent, by a count and not by a clock: the same input must give the same scene.

    Raises:
        UnsuitedError: the islands have more than `config.convex_columns` columns.
    """
    area = sum(int(np.isfinite(island.top).sum()) for island in islands) * whole.grid.cell**2
    count = round(area / COARSE**2)
    if count > config.convex_columns:
        raise UnsuitedError(
            "the terrain is too large for a convex decomposition",
            expected=f"at most {config.convex_columns} columns of {100 * COARSE:g} cm",
            found=f"{count}, {area:.2f} m^2 of curved surface",
            hint="choose --contact hfield or boxes, or raise --convex-columns",
        )


def convex(shape: Shape, config: SceneConfig) -> ContactModel:
    """Convex parts whose concavity is at most `config.convex_threshold` metres, on an infinite floor.

    CoACD: Wei, Liu, Ling, Su, SIGGRAPH 2022. Solids are closed beforehand from columns of 1 cm.

    Raises:
        UnsuitedError: see `check_columns`.
    """
    whole = shape.coarse
    check_columns(whole, whole.islands, config)
    exact = as_contact("convex", [], whole.floor, whole.statistics, shape.solids)
    return with_parts(exact, shape, range(len(whole.islands)), config)


def with_parts(contact: ContactModel, shape: Shape, islands: Iterable[int], config: SceneConfig) -> ContactModel:
    """A contact model, and the convex parts of some of the coarse islands of its shape."""
    threshold = allowed_concavity(shape, config)
    geoms, assets = list(contact.geoms), list(contact.assets)
    for n in islands:
        for k, part in enumerate(convex_parts(shape.coarse, shape.coarse.islands[n], threshold)):
            assets.append(Asset.of_points(f"convex_{n}_{k}", part))
            geoms.append(Geom(assets[-1].name, "mesh", asset=assets[-1].name))
    statistics = dict(contact.statistics) | {"threshold_m": threshold, "parts": len(geoms) - len(shape.coarse.floor)}
    return ContactModel(contact.representation, tuple(geoms), tuple(assets), statistics)


def allowed_concavity(shape: Shape, config: SceneConfig) -> float:
    """Metres that a part's hull may stand off the surface: in a scan, whose noise is concave everywhere, as much as the
    verdict allows 5 % of places."""
    most = config.contact_tolerance[1] if shape.mesh.noise_m is not None else 0.0
    return max(config.convex_threshold, most)


def convex_parts(whole: Terrain, island: Island, threshold: float) -> list[F64]:
    """[(M, 3) corners of a convex part, metres], each grown by OVERLAP about its middle."""
    import coacd

    coacd.set_log_level("error")
    solid = coacd.Mesh(*island_solid(whole, island))
    parts = coacd.run_coacd(
        solid,
        threshold=threshold,
        real_metric=True,
        preprocess_mode="off",
        mcts_iterations=20,  # a chair's scan: 119 CPU s for some 300 with 60, at a concavity of 1 cm
        max_ch_vertex=64,
        seed=0,
    )
    out = []
    for vertices, _ in parts:
        corners = np.asarray(vertices, float)
        outward = corners - corners.mean(0)
        out.append(corners + OVERLAP * np.sign(outward))
    return out
