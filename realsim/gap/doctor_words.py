"""What to change about a finding, in the words of mjlab, Isaac Lab and Unitree's deployment."""

from __future__ import annotations

from realsim.gap.checks.contract.settings import setting
from realsim.gap.effects import EFFECTS

FRAMEWORKS = {"mjlab": "mjlab", "Isaac Lab": "isaaclab", "Unitree": "unitree"}
"""Name for a reader -> name in `contract.settings`."""


def setting_of(kind: str, framework: str) -> str:
    """What to change about a kind of contract error, or about an effect."""
    if kind not in EFFECTS:
        return setting(kind, FRAMEWORKS[framework])
    own = EFFECTS[kind].words.settings
    return own[list(FRAMEWORKS).index(framework)] if own else f"{kind}: as in the patched model.xml of realsim diagnose"
