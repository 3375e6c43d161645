"""The scene on disk: MJCF with visual mesh and collision geometry, compiled, stepped and checked.

A collision representation is a function `(Shape, SceneConfig) -> ContactModel`, of a mesh with its ground: one small
file in `contact/`, one line here.
"""

from __future__ import annotations

from realsim.export.contact_mesh import contact_mesh
from realsim.export.formats import EXPORTERS, export_scene
from realsim.export.scene import write_scene
from realsim.registry import Registry

__all__ = ["CONTACT", "EXPORTERS", "contact_mesh", "export_scene", "write_scene"]

CONTACT = Registry(
    "collision representation",
    {
        "boxes": "realsim.export.contact.boxes:boxes",
        "hybrid": "realsim.export.contact.hybrid:hybrid",
        "sheets": "realsim.export.contact.sheets:sheets",
        "convex": "realsim.export.contact.convex:convex",
        "hfield": "realsim.export.contact.hfield:hfield",
        "sdf": "realsim.export.contact.sdf:sdf",
        "hull": "realsim.export.contact.hull:hull",
    },
)
