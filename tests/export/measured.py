"""Figures of collision geometry against exact meshes, for the tests of contact."""

from __future__ import annotations

import numpy as np

from realsim.exports.config import SceneConfig
from realsim.exports.contact.base import ContactModel
from realsim.exports.contact.fidelity import measure
from realsim.exports.contact.probe import Reference, spec_of
from realsim.types import TerrainMesh

CONFIG = SceneConfig()
FACING_UP = np.array([1.0, 0, 0, 0])


def reference(mesh: TerrainMesh) -> Reference:
    return Reference(mesh.vertices, mesh.triangles)


def fidelity(contact: ContactModel, mesh: TerrainMesh, **kwargs) -> dict:
    return dict(measure(spec_of(contact), reference(mesh), 0.0, **kwargs).figures)
