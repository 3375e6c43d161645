"""Options of poses and points."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class OnnxConfig:
    """The backends `onnx` and `onnx+depth`."""

    model: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """ONNX file of a feed-forward model, for the backends onnx and onnx+depth (default: the small one that ships)."""
    provider: str | None = None
    """Execution provider of onnxruntime: cpu, cuda, coreml, ... (default: the fastest that is installed)."""
    max_views: int | None = None
    """Largest number of views per run of the model (default: as declared, and as fits into memory)."""
    min_confidence: float = 0.1
    """Predicted pixels below this confidence (0..1) are left out."""
    drop_least_sure: float = 5.0
    """Percentage of each view's predicted pixels, the least confident ones, that are left out."""
    kept_in: Annotated[Path | None, tyro.conf.Suppress] = None
    """Folder in which a model's outputs are kept for the next run."""

    def __post_init__(self) -> None:
        if not 0 <= self.min_confidence < 1:
            raise ValueError(f"need 0 <= min_confidence < 1, found {self.min_confidence:g}")
        if not 0 <= self.drop_least_sure < 100:
            raise ValueError(f"need 0 <= drop_least_sure < 100, found {self.drop_least_sure:g}")
        if self.max_views is not None and self.max_views < 1:
            raise ValueError(f"need max_views >= 1, found {self.max_views}")


@dataclass(frozen=True)
class PointsConfig:
    backend: Annotated[str, tyro.conf.arg(metavar="{rgbd,colmap,onnx,onnx+depth}")] = "rgbd"
    """Source of points and poses."""
    poses: Literal["auto", "given", "estimate"] = "auto"
    """`given` uses the capture's poses and fails without them, `estimate` ignores them, `auto` uses them if present."""
    refine: bool = True
    """Refine given poses against the depth."""
    correct_depth_bias: bool = True
    """With metric poses given, recover the depth sensor's scale bias from multi-view consistency and correct it."""
    learned_matches: bool = True
    """Where poses are estimated and features leave the frames in pieces, ask the learned matcher (XFeat)."""
    onnx: OnnxConfig = field(default_factory=OnnxConfig)
    seed: Annotated[int, tyro.conf.Suppress] = 0
    """Seed of everything random in this stage."""
