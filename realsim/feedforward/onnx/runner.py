"""Frames through a model: runs that fit into memory, joined, masked, and without what does not belong."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.cache import StageCache
from realsim.core.errors import CaptureError, ModelError, PoseError
from realsim.core.files import digest
from realsim.core.progress import note
from realsim.core.types import F32, F64, Bool, Frame
from realsim.feedforward.config import OnnxConfig
from realsim.feedforward.onnx.adapters import ADAPTERS, Prediction
from realsim.feedforward.onnx.consistency import agreement, believed, connected
from realsim.feedforward.onnx.inputs import Inputs
from realsim.feedforward.onnx.place import Placed, place_pairs, place_single, place_windows
from realsim.feedforward.onnx.preprocess import Grid, camera_matrices
from realsim.feedforward.onnx.session import Model, OutOfMemory

EMPTY = 0.02
"""A view with a smaller share of believed pixels says nothing."""
HEADS = 0.05
"""Relative distance between a model's two heads above which a warning is given."""
FOCAL = 0.05
"""The same for its focal length against the capture's."""
FOCAL_WRONG = 2.0
"""A focal length that is off by more than this factor, either way, is an error: lenses of robots and phones differ by
less, so the model has understood nothing of the picture, or its `norm`, `fit` or `kind` is wrong."""


@dataclass(frozen=True)
class Views:
    """A model's output for the frames that could be connected."""

    used: tuple[int, ...]
    """Indices of the N views among the frames."""
    depth: F32
    """(N, H, W) along z on the model's grid, one unknown scale; 0 where not believed."""
    conf: F32
    """(N, H, W) 0..1."""
    T_world_camera: F64
    """(N, 4, 4) same scale; NaN for a model of single views."""
    grids: tuple[Grid, ...]
    metric_claim: float | None
    lost: dict[int, str]
    """Index -> why."""
    warnings: tuple[str, ...] = ()
    statistics: dict[str, Any] = field(default_factory=dict)


def predict(
    frames: Sequence[Frame], model: Model, config: OnnxConfig, *, with_depth: bool, poses: bool, kept_in: Path | None
) -> Views:
    """Run `model` over frames.

    Args:
        with_depth: whether a model that takes sensor depth is given it.
        poses: whether poses are wanted: a model of single views cannot give them.
        kept_in: folder for the model's outputs, reused when model and pictures are the same.

    Raises:
        CaptureError: frames without colour; one view for a model of pairs.
        ModelError: outputs that do not fit, nothing but NaN, not even the fewest views fit into memory.
        PoseError: several frames, poses wanted, and a model of single views; no two views that hang together.
    """
    spec = model.spec
    if spec.kind == "mono" and poses and len(frames) > 1:
        raise PoseError(
            "a model of single views gives no poses",
            file=model.path,
            expected="one frame, or a model of many views",
            found=f"{len(frames)} frames",
            hint="use --backend onnx+depth: poses from the depth, and the model for what the depth did not see",
        )
    if spec.kind == "pair" and len(frames) < 2:
        raise CaptureError("a model of pairs needs two views", found="one view only", hint="capture more views")
    inputs = Inputs.of(frames, spec, with_depth=with_depth)
    runs = _Runs(model, inputs, StageCache(kept_in))
    placed, most, shrunk = _placed(runs, len(frames), config)
    return _judged(placed, inputs, model, config, [*model.warnings, *shrunk], most)


class _Runs:
    """The model on views by index; a run that was kept is not repeated."""

    def __init__(self, model: Model, inputs: Inputs, kept: StageCache) -> None:
        self.model, self.inputs, self.kept = model, inputs, kept
        self.code = digest(*model.envelope.files)

    def __call__(self, views: Sequence[int]) -> Prediction:
        feeds = self.inputs.feeds(views)
        parts = (part for item in sorted(feeds.items()) for part in item)
        key = digest(self.code, *parts, sorted(self.model.spec.ports.items()))
        found, _ = self.kept.get_or_make(f"model-{key}", lambda: self.model.run(feeds))
        distinct = tuple(views) if self.model.spec.n_static is None else tuple(dict.fromkeys(views))
        try:
            return ADAPTERS[self.model.spec.kind].unpack(found, self.inputs.call(distinct, len(views)))
        except ModelError as error:
            raise ModelError(
                error.message, file=self.model.path, expected=error.expected, found=error.found, hint=error.hint
            ) from error


def _placed(runs: _Runs, n: int, config: OnnxConfig) -> tuple[Placed, int, list[str]]:
    """All views placed, the number of views per run, and warnings."""
    spec = runs.model.spec
    limits = [v for v in (spec.n_static, spec.max_views, config.max_views) if v is not None]
    most = min([*limits, max(runs.inputs.views_in_memory(), spec.n_static or 0)])
    notes: list[str] = []
    while True:
        try:
            if spec.kind == "pair":
                return place_pairs(runs, n), 2, notes
            if spec.kind == "mono":
                return place_single(runs, n), 1, notes
            if most < 2 and n > 1:
                raise OutOfMemory("one view per run cannot be joined")
            return place_windows(runs, n, most, spec.n_static), min(most, n), notes
        except OutOfMemory as error:
            # A frozen graph, a pair and a single view cannot be made smaller.
            smaller = min(most, n) // 2
            if spec.n_static or spec.kind in ("pair", "mono") or smaller < 2:
                h, w = runs.inputs.size
                raise ModelError(
                    "the model does not fit into memory", file=runs.model.path,
                    found=f"a run of {min(most, n)} views of {h} x {w} pixels fails: {error or 'out of memory'}",
                    hint="use a smaller model, or set a smaller fixed_hw in its sidecar",
                ) from error  # fmt: skip
            notes.append(f"out of memory with {min(most, n)} views per run: repeated with {smaller}")
            note(notes[-1])
            most = smaller


def _judged(
    placed: Placed, inputs: Inputs, model: Model, config: OnnxConfig, warnings: list[str], most: int
) -> Views:  # fmt: skip
    """Masks, and which views stay."""
    n = len(placed.depth)
    figures = {name: float(np.median(v)) for name, v in placed.figures.items()}
    keep = np.stack([_mask(placed, inputs, i, config) for i in range(n)])
    lost = _unusable(placed, keep, posed=model.spec.kind != "mono")
    if len(lost) == n:
        raise ModelError(
            "the model returned no usable points", file=model.path,
            expected="finite points in front of the cameras",
            found="; ".join(dict.fromkeys(lost.values())),
            hint="NaN from a half-precision export: try it in float32; all masked: are norm and conf right?",
        )  # fmt: skip
    ratio = figures.get("focal_ratio", 1.0)
    if ratio > FOCAL_WRONG or ratio < 1 / FOCAL_WRONG:  # NaN: no pixel says anything about it
        raise ModelError(
            "the model's points do not fit the camera", file=model.path,
            expected=f"a focal length within a factor of {FOCAL_WRONG:g} of the capture's",
            found=f"{ratio:.2g} times the capture's",
            hint="are `norm`, `fit` and `kind` right? See: realsim model inspect. Is the capture's calibration right?",
        )  # fmt: skip
    alive = np.array([i for i in range(n) if i not in lost])
    share: F64 = np.zeros((n, n))
    if n > 1 and model.spec.kind != "mono":
        K = camera_matrices(list(inputs.grids))
        share = agreement(placed.depth, keep, K, placed.T_world_camera)
        # Views of different parts are in different worlds: that they overlap there means nothing.
        share[placed.part[:, None] != placed.part[None]] = 0
        groups = [alive[group] for group in connected(share[np.ix_(alive, alive)])]
        if len(groups[0]) < 2:
            raise PoseError(
                "the model's views cannot be connected", file=model.path,
                expected="views that show the same surfaces from nearby",
                found=f"no two of {len(alive)} views that confirm each other",
                hint="capture with more overlap, or use --backend rgbd",
            )  # fmt: skip
        for group in groups[1:]:
            for i in group:
                lost[int(i)] = "shares no surface with the other views as the model places it; not glued on"
        alive = groups[0]
    used = tuple(int(i) for i in alive)
    if n == 1 and model.spec.kind != "mono":
        warnings.append("one view only: no other view can confirm the model's output")
    depth = np.where(keep, placed.depth, 0).astype(np.float32)
    claim = 1.0 if model.spec.scale == "applied" else None
    if model.spec.scale == "factor" and placed.claims:
        claim = float(np.median(placed.claims))
    return Views(
        used=used,
        depth=depth[alive],
        conf=placed.conf[alive],
        T_world_camera=placed.T_world_camera[alive],
        grids=tuple(inputs.grids[i] for i in used),
        metric_claim=claim,
        lost=lost,
        warnings=(*warnings, *_notable(figures)),
        statistics={
            "model": model.path.name,
            "kind": model.spec.kind,
            "provider": model.provider,
            "contract": {k: [getattr(model.spec, k), how] for k, how in model.spec.origin.items()},
            "size": list(inputs.size),
            "views_a_run": most,
            "parts": len(set(placed.part.tolist())) if model.spec.kind != "mono" else None,
            "believed": float(keep[alive].mean()),
            "overlap": float(np.median(share[np.ix_(alive, alive)].max(1))) if len(used) > 1 else None,
            **figures,
        },
    )


def _mask(placed: Placed, inputs: Inputs, i: int, config: OnnxConfig) -> Bool:
    inside = np.zeros(placed.mask[i].shape, bool)
    inside[inputs.grids[i].content] = True
    return believed(
        placed.depth[i], placed.conf[i], placed.mask[i] & inside, config.min_confidence, config.drop_least_sure
    )


def _unusable(placed: Placed, keep: Bool, *, posed: bool) -> dict[int, str]:
    """Index -> why, of views that cannot be used whatever the others are."""
    out = {}
    for i in range(len(keep)):
        finite = float(np.isfinite(placed.depth[i]).mean())
        if posed and not np.isfinite(placed.T_world_camera[i]).all():
            out[i] = "the model gave a pose that is not a number (NaN)"
        elif finite < 0.5:
            out[i] = f"the model gave NaN for {100 * (1 - finite):.0f} percent of the pixels"
        elif keep[i].mean() < EMPTY:
            out[i] = f"the model is sure of only {100 * float(keep[i].mean()):.1f} percent of the pixels"
    return out


def _notable(figures: dict[str, float]) -> list[str]:
    out = []
    if (off := figures.get("heads_disagree", 0.0)) > HEADS:
        out.append(f"the model's points and its poses disagree by {100 * off:.0f} percent of the distance")
    if abs((ratio := figures.get("focal_ratio", 1.0)) - 1) > FOCAL:
        out.append(f"the model's focal length is {100 * (ratio - 1):+.0f} percent of what it is")
    return out


def without(views: Views, drop: dict[int, str]) -> Views:
    """The same without some of the frames (index among the frames -> why)."""
    keep = [k for k, i in enumerate(views.used) if i not in drop]
    return replace(
        views,
        used=tuple(views.used[k] for k in keep),
        depth=views.depth[keep],
        conf=views.conf[keep],
        T_world_camera=views.T_world_camera[keep],
        grids=tuple(views.grids[k] for k in keep),
        lost={**views.lost, **drop},
    )
