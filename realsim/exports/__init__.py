"""The scene on disk: MJCF with visual mesh and collision geometry, compiled, stepped and checked.

A collision representation is a function `(Shape, SceneConfig) -> ContactModel`, of a mesh with its ground: one small
file in `contact/`, one line here.
"""

from __future__ import annotations

from realsim.exports.any_mesh import contact_mesh
from realsim.exports.formats import ALL, EXPORTERS, Exported, export_scene
from realsim.exports.scene import write_scene
from realsim.registry import Registry

__all__ = ["ALL", "CONTACT", "EXPORTERS", "Exported", "contact_mesh", "export_scene", "write_scene"]

CONTACT = Registry(
    "collision representation",
    {
        "boxes": "realsim.exports.contact.boxes:boxes",
        "hybrid": "realsim.exports.contact.hybrid:hybrid",
        "convex": "realsim.exports.contact.convex:convex",
        "sheets": "realsim.exports.contact.sheets:sheets",
        "hfield": "realsim.exports.contact.hfield:hfield",
        "sdf": "realsim.exports.contact.sdf:sdf",
        "hull": "realsim.exports.contact.hull:hull",
    },
)
