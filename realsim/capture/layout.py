"""The contract of a capture layout: four members, one file each, one line in `LAYOUTS`.

A layout only knows names and conventions: it turns a folder into a `FrameSet` whose readers give plain metres.
What is the same for all of them (range limits, damaged frames, invalid poses, blur, duplicates, the choice among
too many frames) happens afterwards, once, in `finishing.py`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from realsim.capture.config import CaptureConfig
from realsim.core.errors import CaptureError
from realsim.core.types import FrameSet, Scan

CAMERA, PHONE = 0.006, 0.04
"""Relative standard errors of depth sensors' own scale. Depth cameras (structured light, stereo) after calibration; of
phones' LiDAR one real capture is 4 percent off the phone's own poses (scannerapp, real iPhone)."""


@dataclass(frozen=True)
class Recognition:
    """What a layout found in a folder."""

    evidence: tuple[str, ...] = ()
    """Evidence for this layout, in words; empty if there is none."""
    missing: tuple[str, ...] = ()
    """Missing parts that the layout needs, in words."""
    score: int = 0
    """How specific the evidence is. Among complete layouts the highest wins; equal ones are ambiguous."""

    def __post_init__(self) -> None:
        for name in ("evidence", "missing"):
            value = getattr(self, name)
            if not isinstance(value, tuple):
                raise CaptureError(
                    f"a layout's `recognise` answers with `{name}` that is no tuple of texts",
                    expected='Recognition(("12 x shot_*.npz",), missing=(), score=30)', found=repr(value)[:80],
                    hint="docs/captures.md, a layout of your own, shows one",
                )  # fmt: skip

    @property
    def complete(self) -> bool:
        """Whether the folder can be read with this layout."""
        return bool(self.evidence) and not self.missing


@dataclass(frozen=True)
class Layout:
    """One way in which captures are stored."""

    name: str
    looks_for: str
    """Its distinctive files, for the message if nothing is recognised."""
    recognise: Callable[[Path], Recognition]
    """A cheap look at names (no image is decoded); must not raise for a folder of any other kind."""
    read: Callable[[Path, CaptureConfig], FrameSet | Scan]
    """All frames in order, lazily: `read_depth` in metres without range limits, poses as written (4x4, unchecked).

    The readers of a frame are called again and again, from two threads, and travel to other processes: small picklable
    objects such as `DepthImage`, without open files. A reader that has a method `step()` (metres that the value 1
    stands for) lets the check of the depth unit name the unit that would fit.
    """
    sensor_sigma: float = CAMERA
    """Relative standard error of the scale of the depth sensor that writes this layout."""
