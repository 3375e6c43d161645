"""Diagnose the sim-to-real gap: where it lies, which unmodelled effect causes it, how far it shrinks.

    from realsim.gap import load_case, diagnose
    found = diagnose(load_case("case"))
    print(found.sentence)

`apply_patch` changes a plain MuJoCo spec, `explain` says what an effect looks like, `run_case` does it all on disk,
`check_case` looks at the health of a log alone, `start_case` makes the folder of a new case.
"""

from typing import TYPE_CHECKING

from realsim.core.registry import lazily

if TYPE_CHECKING:
    from realsim.gap.answer.diagnosis import Diagnosis
    from realsim.gap.answer.patch import apply_patch
    from realsim.gap.case.case import Case, Run, load_case
    from realsim.gap.config import DiagnoseConfig
    from realsim.gap.effects import EFFECTS
    from realsim.gap.effects.lookup import explain
    from realsim.gap.pipeline import diagnose
    from realsim.gap.run import check_case, run_case
    from realsim.gap.scaffold import start_case

_HOME = {
    "Case": "case.case",
    "DiagnoseConfig": "config",
    "Diagnosis": "answer.diagnosis",
    "EFFECTS": "effects",
    "Run": "case.case",
    "apply_patch": "answer.patch",
    "check_case": "run",
    "diagnose": "pipeline",
    "explain": "effects.lookup",
    "load_case": "case.case",
    "run_case": "run",
    "start_case": "scaffold",
}
"""Name -> its module, imported when the name is first used: the help of a command needs the configuration alone."""

__all__ = [
    "EFFECTS",
    "Case",
    "DiagnoseConfig",
    "Diagnosis",
    "Run",
    "apply_patch",
    "check_case",
    "diagnose",
    "explain",
    "load_case",
    "run_case",
    "start_case",
]


__getattr__ = lazily(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
