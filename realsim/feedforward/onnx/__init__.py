"""Pointmaps from a feed-forward model in an ONNX file: `onnx` by colour alone, `onnx+depth` together with the sensor.

Any model that fits the contract (docs/models.md) runs through the same code; torch is not needed.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from realsim.core.errors import ModelError
from realsim.core.types import Dropped, Frame, FrameSet, PointView, Solution
from realsim.feedforward.backend import Backend
from realsim.feedforward.config import PointsConfig


def solve(frames: FrameSet, config: PointsConfig) -> Solution:
    """Poses and depth by the model alone, up to scale. Given poses and sensor depth are not looked at.

    `arrays` of the result: `depth` (N, H, W) float32 on the model's grid, 0 where not believed, `conf` (N, H, W) uint8
    (255 is sure), `grid` (N, 6) where the picture lies on it.

    Raises:
        ModelError, CaptureError, PoseError: see `realsim.feedforward.onnx.runner.predict`.
    """
    from realsim.feedforward.onnx.runner import predict
    from realsim.feedforward.onnx.session import open_model
    from realsim.feedforward.onnx.views import pack

    model = open_model(model_file(config), config.onnx.provider)
    found = predict(frames.frames, model, config.onnx, with_depth=False, poses=True, kept_in=config.onnx.kept_in)
    T = found.T_world_camera if np.isfinite(found.T_world_camera).all() else np.eye(4)[None]
    return Solution(
        used=found.used,
        T_world_camera=np.linalg.inv(T[0]) @ T,
        world_is_capture=False,
        metric_claim=found.metric_claim,
        dropped=tuple(Dropped(frames.frames[i].name, why) for i, why in sorted(found.lost.items())),
        warnings=found.warnings,
        statistics={"poses": "by the model", **found.statistics},
        arrays=pack(found),
    )


def load_views(used: tuple[Frame, ...], solution: Solution) -> tuple[tuple[Frame, ...], Callable[[int], PointView]]:
    """Views on the frames' depth grids: the model's depth along the capture's own rays, camera frame, up to scale."""
    from realsim.feedforward.onnx.views import predicted_view

    return used, lambda i: predicted_view(used[i], solution.arrays, i)


SHIPPED = Path(__file__).with_name("realsim_pointmap.onnx")
"""What runs where the configuration names no model; CARD.md beside it says what it can do."""


def model_file(config: PointsConfig) -> Path:
    """The model that the configuration names, or the one that ships.

    Raises:
        ModelError: the one that ships is not there.
    """
    if config.onnx.model is None and not SHIPPED.is_file():
        raise ModelError(
            f"the backend {config.backend} needs a model",
            file=SHIPPED,
            expected="the model that ships with realsim, or --model FILE.onnx",
            found="neither",
            hint="install realsim again; docs/choosing.md lists other models",
        )
    return config.onnx.model or SHIPPED


def model_files(config: PointsConfig) -> tuple[Path, ...]:
    """Files besides the capture that the result depends on.

    Raises:
        ModelError: no model, or not one.
    """
    from realsim.core.onnx_file import read_envelope
    from realsim.feedforward.onnx.spec import sidecar

    path = model_file(config)
    beside = sidecar(path)
    return (*read_envelope(path).files, *((beside,) if beside.is_file() else ()))


BACKEND = Backend(solve, load_views, model_files)
