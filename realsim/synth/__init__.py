"""Synthetic captures with exact truth: terrains of simple solids, a hand-held camera, an imperfect depth sensor.

`write_capture` renders one, `compare` measures a reconstruction against its truth.
"""

from realsim.registry import Registry

TERRAINS = Registry(
    "terrain",
    {
        "stakes": "realsim.synth.courses:stakes",
        "beams": "realsim.synth.courses:beams",
        "wedges": "realsim.synth.courses:wedges",
        "boxes": "realsim.synth.courses:boxes",
        "trapezoids": "realsim.synth.courses:trapezoids",
        "boston": "realsim.synth.courses:boston",
        "mixed": "realsim.synth.courses:mixed",
    },
)
"""Name -> (rng) -> list of obstacle solids and the length of the course; see `realsim.synth.courses`."""

PLACES = Registry(
    "place",
    {
        "corridor": "realsim.synth.places:corridor",
        "ring": "realsim.synth.places:ring",
        "stairwell": "realsim.synth.places:stairwell",
        "stake_row": "realsim.synth.places:stake_row",
    },
)
"""Name -> (rng) -> `realsim.synth.places.Place`: places that repeat."""


def __getattr__(name: str) -> object:
    """`write_capture`, `SynthCapture`, `SynthConfig` and `compare`, loaded when they are first used."""
    from importlib import import_module

    modules = {"write_capture": "capture", "SynthCapture": "capture", "SynthConfig": "config", "compare": "errors"}
    if name not in modules:
        raise AttributeError(name)
    return getattr(import_module(f"realsim.synth.{modules[name]}"), name)
