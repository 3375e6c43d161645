"""realsim: from a depth camera to a MuJoCo scene, and from a robot's logs to the cause of its sim-to-real gap.

    import realsim as rs

    scene = rs.reconstruct("frames", "scene")  # or rs.contact("mesh.stl"), rs.load_scene("scene")
    found = rs.diagnose("case", "diagnosis")

Nothing heavy is imported before a function is called.
"""

from typing import TYPE_CHECKING

import realsim.export as _export  # noqa: F401 (first: later, it would hide the function of its name)
from realsim.api import export
from realsim.core.errors import RealsimError
from realsim.core.registry import lazily

if TYPE_CHECKING:
    from realsim.api import (
        apply_patch,
        contact,
        diagnose,
        footholds,
        inspect,
        load_case,
        load_diagnosis,
        load_scene,
        next_experiment,
        reconstruct,
    )
    from realsim.capture.config import CaptureConfig
    from realsim.capture.inspection import Inspection
    from realsim.export.config import SceneConfig
    from realsim.gap.case.case import Case
    from realsim.gap.config import DiagnoseConfig, ExciteConfig
    from realsim.pipeline import ReconstructConfig
    from realsim.results import Cause, Diagnosis, GapVerdict, Interval, Scene, SceneVerdict

__version__ = "0.2.0"

_HOME = {
    **dict.fromkeys(
        (
            "inspect",
            "reconstruct",
            "contact",
            "load_scene",
            "load_case",
            "diagnose",
            "load_diagnosis",
            "next_experiment",
            "footholds",
            "apply_patch",
        ),
        "realsim.api",
    ),
    **dict.fromkeys(
        ("Scene", "SceneVerdict", "Diagnosis", "GapVerdict", "Cause", "Interval"),
        "realsim.results",
    ),
    "CaptureConfig": "realsim.capture.config",
    "Inspection": "realsim.capture.inspection",
    "SceneConfig": "realsim.export.config",
    "DiagnoseConfig": "realsim.gap.config",
    "ExciteConfig": "realsim.gap.config",
    "Case": "realsim.gap.case.case",
    "ReconstructConfig": "realsim.pipeline",
}
"""Name -> the module that it is imported from when it is first used (PEP 562)."""

__all__ = [
    "CaptureConfig",
    "Case",
    "Cause",
    "DiagnoseConfig",
    "Diagnosis",
    "ExciteConfig",
    "GapVerdict",
    "Inspection",
    "Interval",
    "RealsimError",
    "ReconstructConfig",
    "Scene",
    "SceneConfig",
    "SceneVerdict",
    "__version__",
    "apply_patch",
    "contact",
    "diagnose",
    "export",
    "footholds",
    "inspect",
    "load_case",
    "load_diagnosis",
    "load_scene",
    "next_experiment",
    "reconstruct",
]


__getattr__ = lazily(__name__, _HOME)


def __dir__() -> list[str]:
    return list(__all__)
