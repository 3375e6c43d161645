"""Synthetic captures with exact truth: terrains of simple solids, a hand-held camera, an imperfect depth sensor.

`write_capture` renders one, `compare` measures a reconstruction against its truth.
"""

from realsim.core.registry import Registry, lazily

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


__getattr__ = lazily(
    __name__,
    {
        **dict.fromkeys(("SynthCapture", "write_capture"), "realsim.synth.capture"),
        "SynthConfig": "realsim.synth.config",
        "compare": "realsim.synth.errors",
    },
)
