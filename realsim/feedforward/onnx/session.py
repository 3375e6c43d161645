"""A model in onnxruntime: opened with a clear word about what is wrong, run, and asked what it can do."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ModelError, RealsimError
from realsim.core.onnx_file import Envelope, read_envelope
from realsim.feedforward.onnx.spec import Port, Spec, make_spec, sidecar

PREFERRED = ("CUDA", "ROCM", "MIGraphX", "DML", "CoreML", "OpenVINO", "CPU")
"""Execution providers that are taken without being requested, the fastest first. TensorRT builds for minutes."""
DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64,
          "tensor(int64)": np.int64, "tensor(int32)": np.int32}  # fmt: skip


class OutOfMemory(Exception):
    """A run did not fit into memory; with fewer views it may."""


def runtime() -> Any:
    """The module onnxruntime, imported with its telemetry off: by default it writes a device id and sends events."""
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    try:
        import onnxruntime
    except ImportError as error:
        raise RealsimError("the backend onnx needs the package onnxruntime", hint="pip install onnxruntime") from error
    return onnxruntime


def providers() -> tuple[str, ...]:
    """Devices that the installed onnxruntime supports, as short names (`cpu`, `cuda`)."""
    return tuple(short(p) for p in _local(runtime()))


def _local(ort: Any) -> list[str]:
    """Providers that compute on this machine (Azure's sends the work elsewhere)."""
    return [p for p in ort.get_available_providers() if p != "AzureExecutionProvider"]


def short(provider: str) -> str:
    """`CUDAExecutionProvider` as a person writes it."""
    return provider.removesuffix("ExecutionProvider").lower()


def choose_provider(wanted: str | None) -> list[str]:
    """Full names for onnxruntime, the CPU last.

    Raises:
        ModelError: what was requested is not there.
    """
    there = _local(runtime())
    if wanted is None:
        known = {short(p): p for p in there}
        first = next((known[p.lower()] for p in PREFERRED if p.lower() in known), there[-1])
    else:
        matching = [p for p in there if wanted.lower() in (p.lower(), short(p))]
        if not matching:
            raise ModelError(
                f"the execution provider {wanted} is not there",
                expected=f"one of {', '.join(map(short, there))}",
                hint="install the onnxruntime that has it (onnxruntime-gpu for cuda), or leave --provider out",
            )
        first = matching[0]
    return list(dict.fromkeys([first, "CPUExecutionProvider"]))


@dataclass(frozen=True)
class Model:
    """An opened model that fits the contract."""

    path: Path
    envelope: Envelope
    spec: Spec
    provider: str
    """Short name of its device."""
    session: Any = field(repr=False)
    warnings: tuple[str, ...] = ()

    def run(self, feeds: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """Outputs by role.

        Raises:
            OutOfMemory: retry with fewer views.
            ModelError: onnxruntime refuses; the usual cause is an axis that is declared dynamic and is not.
        """
        names = list(dict.fromkeys(self.spec.ports.values()))
        types = {p.name: p.type for p in (self.spec.image, *self.spec.extra_inputs)}
        cast = {k: v.astype(DTYPES.get(types[k], np.float32), copy=False) for k, v in feeds.items()}
        try:
            values = dict(zip(names, self.session.run(names, cast), strict=True))
        except MemoryError as error:
            raise OutOfMemory from error
        except Exception as error:  # onnxruntime's exceptions have no common base but this
            text = _sentence(error)
            if re.search(r"alloc|out of memory|memory limit|CUDA error 2\b", text, re.IGNORECASE):
                raise OutOfMemory(text) from error
            shapes = ", ".join(f"{k} {list(v.shape)}" for k, v in feeds.items())
            raise ModelError(
                "the model cannot be run on these inputs",
                file=self.path,
                expected=", ".join(map(str, (self.spec.image, *self.spec.extra_inputs))) + " (as the file declares)",
                found=f"{shapes}: {text}",
                hint="an axis declared dynamic may be fixed in the graph: set n_static, max_views or fixed_hw in "
                f"{sidecar(self.path).name} beside it (realsim model inspect tries which sizes work)",
            ) from error
        return {role: np.asarray(values[name]) for role, name in self.spec.ports.items()}


def open_model(path: Path, provider: str | None = None) -> Model:
    """Read the envelope, open a session, match the contract.

    Raises:
        ModelError: see `read_envelope` and `make_spec`; opset too new; provider absent; a graph that does not load.
    """
    envelope = read_envelope(path)
    ort = runtime()
    chosen = choose_provider(provider)
    options = ort.SessionOptions()
    options.log_severity_level = 4  # errors come as exceptions; shapes that differ from those declared are judged here
    options.use_deterministic_compute = True
    try:
        session = ort.InferenceSession(str(path), options, providers=chosen)
    except MemoryError as error:
        raise ModelError("the model does not fit into memory", file=path, hint="use a smaller model") from error
    except Exception as error:
        raise _cannot_load(envelope, _sentence(error), ort.__version__) from error
    spec = make_spec(path, envelope.metadata, _ports(session.get_inputs()), _ports(session.get_outputs()))
    used = session.get_providers()[0]
    warnings = []
    if used != chosen[0]:
        warnings.append(f"onnxruntime could not start {short(chosen[0])}: the model runs on {short(used)}")
    if spec.guessed:
        warnings.append(f"guessed, because {path.name} does not say: {', '.join(spec.guessed)}")
    return Model(path, envelope, spec, short(used), session, tuple(warnings))


def _ports(values: Any) -> list[Port]:
    return [Port(v.name, tuple(v.shape), v.type) for v in values]


def _cannot_load(envelope: Envelope, text: str, version: str) -> ModelError:
    if "opset" in text.lower() or "ir version" in text.lower():
        limit = re.search(r"till opset (\d+)|max supported IR version: (\d+)", text)
        ceiling = (
            f"opset up to {limit[1]}" if limit and limit[1] else f"IR version up to {limit[2]}" if limit else "older"
        )
        return ModelError(
            "the model is newer than the installed onnxruntime",
            file=envelope.path,
            expected=f"{ceiling} (onnxruntime {version})",
            found=f"opset {envelope.opset}, IR version {envelope.ir_version}",
            hint="update onnxruntime, or export again with a lower --opset",
        )
    if re.search(r"external|\.data\b|file_size|out of bounds", text, re.IGNORECASE):
        return ModelError(
            "the model's weights beside it are incomplete", file=envelope.path, found=text,
            expected=", ".join(envelope.external) or "weights inside the file", hint="copy the .data file again",
        )  # fmt: skip
    return ModelError("onnxruntime cannot load the model", file=envelope.path, found=text)


def _sentence(error: Exception) -> str:
    """onnxruntime's message without its C++ signatures, cut to a readable length."""
    text = re.sub(r"\S*\.(?:cc|h):\d+ .*?\)(?: const)? ", "", str(error).replace("[ONNXRuntimeError] : ", ""))
    text = " ".join(text.split())
    return text if len(text) < 400 else text[:400] + " ..."
