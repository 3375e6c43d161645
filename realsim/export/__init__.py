"""The scene on disk: MJCF with visual mesh and collision geometry, compiled, stepped and checked.

A collision representation is a function `(Shape, SceneConfig) -> ContactModel`, of a mesh with its ground: one small
file in `contact/`, one line here.
"""

from typing import TYPE_CHECKING

from realsim.core.registry import Registry, lazily

if TYPE_CHECKING:
    from realsim.export.any_mesh import contact_mesh
    from realsim.export.formats import ALL, EXPORTERS, Exported, export_scene
    from realsim.export.scene import write_scene

__all__ = ["ALL", "CONTACT", "EXPORTERS", "Exported", "contact_mesh", "export_scene", "write_scene"]

CONTACT = Registry(
    "collision representation",
    {
        "boxes": "realsim.export.contact.boxes:boxes",
        "hybrid": "realsim.export.contact.hybrid:hybrid",
        "convex": "realsim.export.contact.convex:convex",
        "sheets": "realsim.export.contact.sheets:sheets",
        "hfield": "realsim.export.contact.hfield:hfield",
        "sdf": "realsim.export.contact.sdf:sdf",
        "hull": "realsim.export.contact.hull:hull",
    },
)

__getattr__ = lazily(
    __name__,
    {
        **dict.fromkeys(("ALL", "EXPORTERS", "Exported", "export_scene"), "realsim.export.formats"),
        "contact_mesh": "realsim.export.any_mesh",
        "write_scene": "realsim.export.scene",
    },
)
