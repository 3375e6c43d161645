"""`sdf`: signed distance fields of the solids, as MuJoCo computes them from a mesh. Faithful and slow."""

from realsim.core.meshes import vertex_normals
from realsim.export.config import SceneConfig
from realsim.export.contact.base import Asset, ContactModel, Geom
from realsim.export.contact.shape import Shape
from realsim.export.contact.solids import island_solid
from realsim.export.visual import obj_bytes


def sdf(shape: Shape, config: SceneConfig) -> ContactModel:
    """One distance field for everything connected, on an infinite floor; solids are closed from columns of 1 cm."""
    whole = shape.coarse
    geoms, assets = list(whole.floor), []
    for k, island in enumerate(whole.islands):
        vertices, faces = island_solid(whole, island)
        data = obj_bytes(vertices, faces, vertex_normals(vertices, faces))
        assets.append(Asset(f"solid_{k}", "mesh", f"solid_{k}.obj", data))
        geoms.append(Geom(f"solid_{k}", "sdf", asset=f"solid_{k}"))
    return ContactModel("sdf", tuple(geoms), tuple(assets), whole.statistics | {"solids": len(assets)})
