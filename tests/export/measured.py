"""Figures of collision geometry against exact meshes, for the tests of contact."""

from functools import cache

import numpy as np

from realsim.core.types import TerrainMesh
from realsim.export.config import SceneConfig
from realsim.export.contact.base import ContactModel
from realsim.export.contact.boxes import boxes
from realsim.export.contact.fidelity import measure
from realsim.export.contact.probe import Reference, spec_of
from realsim.export.contact.shape import Shape
from tests.truths.solids import terrain

CONFIG = SceneConfig()
FACING_UP = np.array([1.0, 0, 0, 0])


@cache
def boxes_of(name: str) -> ContactModel:
    """Of a made terrain, on the ground."""
    return boxes(Shape(terrain(name), 0.0), CONFIG)


def reference(mesh: TerrainMesh) -> Reference:
    return Reference(mesh.vertices, mesh.triangles)


def fidelity(contact: ContactModel, mesh: TerrainMesh, **kwargs) -> dict:
    return dict(measure(spec_of(contact), reference(mesh), 0.0, **kwargs).figures)
