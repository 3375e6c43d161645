"""Diagnose the sim-to-real gap: where it lies, which unmodelled effect causes it, how far it shrinks.

    from realsim.gap import load_case, diagnose
    found = diagnose(load_case("case"))
    print(found.sentence)

`apply_patch` changes a plain MuJoCo spec, `explain` says what an effect looks like, `run_case` does it all on disk.
"""

from __future__ import annotations

from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.answer.patch import apply_patch
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects import EFFECTS
from realsim.gap.explanation import explain
from realsim.gap.logs.case import Case, Run, load_case
from realsim.gap.pipeline import diagnose
from realsim.gap.run import run_case

__all__ = [
    "EFFECTS",
    "Case",
    "DiagnoseConfig",
    "Diagnosis",
    "Run",
    "apply_patch",
    "diagnose",
    "explain",
    "load_case",
    "run_case",
]
