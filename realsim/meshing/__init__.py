"""Surface of an aligned scene: fusion, reconstruction, trimming, clean-up, decimation, quality."""

from typing import TYPE_CHECKING

from realsim.core.registry import lazily
from realsim.meshing.config import METHODS, MeshConfig

if TYPE_CHECKING:
    from realsim.meshing.build_mesh import build
    from realsim.meshing.solids import solid

__all__ = ["METHODS", "MeshConfig", "build", "solid"]

__getattr__ = lazily(__name__, {"build": "realsim.meshing.build_mesh", "solid": "realsim.meshing.solids"})
