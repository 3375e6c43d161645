"""`hull`: the convex hull of the whole mesh, which is what MuJoCo makes of a mesh geom. A baseline, not for use."""

from realsim.core.meshes import used
from realsim.export.config import SceneConfig
from realsim.export.contact.base import Asset, ContactModel, Geom, floor_plane
from realsim.export.contact.columns import check_extent
from realsim.export.contact.shape import Shape


def hull(shape: Shape, config: SceneConfig) -> ContactModel:
    """One convex mesh of all vertices, and a floor."""
    from scipy.spatial import ConvexHull

    mesh, ground_z = shape.mesh, shape.ground_z
    check_extent(mesh)
    named = used(mesh.vertices, mesh.triangles)
    corners = named[ConvexHull(named, qhull_options="QJ").vertices]
    geoms = (floor_plane(ground_z), Geom("hull", "mesh", asset="hull"))
    return ContactModel("hull", geoms, (Asset.of_points("hull", corners),))
