"""The version of MuJoCo that computes: 3 or 4, and which of them not."""

from functools import cache
from importlib.metadata import PackageNotFoundError, version

from realsim.core.errors import RealsimError

BROKEN = {"4.0.0": "its sparse Cholesky factorisation is wrong (mujoco#3767, mended in 4.0.1)"}
"""Version -> why its results are not to be used."""


@cache
def mujoco_version() -> str:
    """The version that is installed; empty if none is."""
    try:
        return version("mujoco")
    except PackageNotFoundError:
        return ""


def check_mujoco() -> None:
    """Raises RealsimError where the installed MuJoCo computes wrong results."""
    found = mujoco_version()
    if found in BROKEN:
        raise RealsimError(
            "this version of MuJoCo cannot be used",
            expected="mujoco 3.11 to 4, but not " + ", ".join(BROKEN),
            found=f"{found}: {BROKEN[found]}",
            hint='pip install --upgrade "mujoco>=3.11,!=4.0.0,<5"',
        )
