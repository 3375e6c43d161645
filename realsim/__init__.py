"""realsim: from a depth camera to a MuJoCo scene, and from a robot's logs to the cause of its sim-to-real gap."""

from realsim.errors import RealsimError

__version__ = "0.1.0"
__all__ = ["RealsimError", "__version__"]
