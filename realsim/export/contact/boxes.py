"""`boxes`: oriented boxes, and prisms where a box does not fit, under every planar piece of the surface.

Convex pieces of the mesh stay as they are. Of the rest, every top face becomes solids with exactly that face: its
outline drawn down to the ground, or to the underside where there is one. Gaps stay open, edges stay sharp, and what
MuJoCo has to collide are boxes and small convex prisms.
"""

from realsim.export.config import SceneConfig
from realsim.export.contact.base import ContactModel, UnsuitedError
from realsim.export.contact.planes import MOST_SEEDS
from realsim.export.contact.prisms import as_contact
from realsim.export.contact.seams import overlap
from realsim.export.contact.shape import Shape


def boxes(shape: Shape, config: SceneConfig) -> ContactModel:
    """Planar pieces of the surface as boxes and prisms, on an infinite floor (on prisms too where it has pits).

    Raises:
        UnsuitedError: a part of the surface is not made of planes.
    """
    if shape.curved:
        found = f"a curved surface: {MOST_SEEDS} planes would hold less than half of it"
        raise UnsuitedError("the terrain is not made of planes", found=found, hint="choose --contact hfield or auto")
    whole = shape.fine
    prisms = [prism for island in shape.planar for prism in island.prisms]
    statistics = whole.statistics | {"plane_tolerance_m": whole.tolerance}
    return overlap(as_contact("boxes", prisms, whole.floor, statistics, shape.solids), whole.tolerance, whole.adds)
