"""Interpretation of a model's outputs. Each kind is one function and one line here, in the order of guessing."""

from realsim.core.registry import Registry
from realsim.feedforward.onnx.adapters.base import Adapter, Call, Prediction

ADAPTERS = Registry(
    "kind of model",
    {
        "pair": "realsim.feedforward.onnx.adapters.posed:PAIR",
        "pointmap": "realsim.feedforward.onnx.adapters.posed:POINTMAP",
        "depth": "realsim.feedforward.onnx.adapters.posed:DEPTH",
        "world": "realsim.feedforward.onnx.adapters.posed:WORLD",
        "mono": "realsim.feedforward.onnx.adapters.mono:ADAPTER",
    },
)

__all__ = ["ADAPTERS", "Adapter", "Call", "Prediction"]
