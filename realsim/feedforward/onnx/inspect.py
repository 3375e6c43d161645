"""Checks a model file against the contract: declared and guessed properties, and trial runs."""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import ModelError
from realsim.core.types import Frame, Intrinsics
from realsim.feedforward.onnx.adapters import ADAPTERS
from realsim.feedforward.onnx.inputs import Inputs
from realsim.feedforward.onnx.session import Model, OutOfMemory, open_model, providers, runtime

COUNTS = (1, 2, 3)
CAMERAS = ((320, 240), (240, 320))


@dataclass(frozen=True)
class Trial:
    """One run on noise."""

    views: int
    size: tuple[int, int]
    """(H, W)."""
    seconds: float | None
    """None where it failed."""
    outcome: str
    """Shapes that came out, or why it failed."""


@dataclass(frozen=True)
class Inspection:
    """Findings about a model file without a capture."""

    model: Model
    megabytes: float
    trials: tuple[Trial, ...] = field(default=())

    @property
    def fits(self) -> bool:
        """Whether at least one trial went through (or none was made)."""
        return not self.trials or any(t.seconds is not None for t in self.trials)

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        model, spec = self.model, self.model.spec
        return {
            "file": str(model.path),
            "megabytes": self.megabytes,
            "producer": model.envelope.producer,
            "opset": model.envelope.opset,
            "external": list(model.envelope.external),
            "inputs": [str(p) for p in (spec.image, *spec.extra_inputs)],
            "outputs": dict(spec.ports),
            "contract": {k: {"value": getattr(spec, k), "from": how} for k, how in spec.origin.items()},
            "provider": model.provider,
            "providers": list(providers()),
            "onnxruntime": runtime().__version__,
            "trials": [vars(t) for t in self.trials],
            "fits": self.fits,
            "warnings": list(model.warnings),
        }

    def render(self) -> str:
        """For a person."""
        model, spec = self.model, self.model.spec
        by = model.envelope.producer or "?"
        lines = [
            f"{model.path.name}: {self.megabytes:.1f} MB, opset {model.envelope.opset}, by {by}",
            f"runs on {model.provider} (there are {', '.join(providers())}), onnxruntime {runtime().__version__}",
        ]
        if model.envelope.external:
            lines.append(f"weights in {', '.join(model.envelope.external)}")
        lines.append("\ninputs")
        lines += [f"  {p}" for p in (spec.image, *spec.extra_inputs)]
        lines.append("outputs")
        lines += [f"  {role:<13} {name}" for role, name in spec.ports.items()]
        lines.append("contract")
        lines += [f"  {k:<13} {_text(getattr(spec, k)):<12} {how}" for k, how in spec.origin.items()]
        if self.trials:
            lines.append("trial on noise")
            lines += [f"  {_trial(t)}" for t in self.trials]
        lines += [f"note: {w}" for w in model.warnings]
        return "\n".join(lines)


def inspect_model(path: Path, provider: str | None = None, *, trial: bool = True) -> Inspection:
    """Open a model, match it with the contract, and run it on noise of a few sizes.

    Raises:
        ModelError: see `open_model`.
    """
    model = open_model(path, provider)
    size = sum(f.stat().st_size for f in model.envelope.files) / 2**20
    return Inspection(model, size, tuple(_trials(model)) if trial else ())


def _trials(model: Model) -> list[Trial]:
    """Declared axes can be wrong: what matters is which counts and sizes go through."""
    spec = model.spec
    counts = {"pair": (2,), "mono": (1,)}.get(spec.kind, (spec.n_static,) if spec.n_static else COUNTS)
    return [_run(model, n, camera) for camera in (CAMERAS if spec.fixed_hw is None else CAMERAS[:1]) for n in counts]


def _run(model: Model, n: int, size: tuple[int, int]) -> Trial:
    w, h = size
    camera = Intrinsics(w, h, float(max(w, h)), float(max(w, h)), w / 2 - 0.5, h / 2 - 0.5)
    noise = np.random.default_rng(0).integers(0, 255, (h, w, 3), np.uint8)
    depth = np.ones((h, w), np.float32)
    frames = [Frame(str(k), camera, lambda: depth, lambda: noise, T_world_camera=np.eye(4)) for k in range(n)]
    inputs = Inputs.of(frames, model.spec, with_depth=True)
    began = time.perf_counter()
    try:
        found = model.run(inputs.feeds(range(n)))
        seconds = time.perf_counter() - began
        ADAPTERS[model.spec.kind].unpack(found, inputs.call(range(n), n))
    except (ModelError, OutOfMemory) as error:
        text = f"{error.message}: {error.found}" if isinstance(error, ModelError) else f"out of memory: {error}"
        return Trial(n, inputs.size, None, text)
    shapes = ", ".join(f"{model.spec.ports[role]} {list(v.shape)}" for role, v in found.items())
    return Trial(n, inputs.size, seconds, shapes)


def _trial(t: Trial) -> str:
    head = f"{t.views} view{'s' if t.views > 1 else ''} of {t.size[0]} x {t.size[1]}"
    if t.seconds is None:
        return f"{head}: FAILS: {t.outcome}"
    return f"{head}: {1e3 * t.seconds / t.views:.0f} ms a view; {t.outcome}"


def _text(value: object) -> str:
    return "x".join(map(str, value)) if isinstance(value, tuple) else "-" if value is None else str(value)
