"""An answer says which engine and settings gave it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import realsim
from realsim.gap.config import DiagnoseConfig
from realsim.gap.provenance import engine, provenance


def hash_of(copy: Path) -> str:
    """The engine's hash as a copy of the package says it."""
    code = "from realsim.gap.provenance import engine; print(engine())"
    done = subprocess.run([sys.executable, "-c", code], cwd=copy, env={"PYTHONPATH": str(copy)}, capture_output=True)
    return done.stdout.decode().strip()


def test_the_hash_follows_what_can_change_an_answer_and_nothing_else(tmp_path: Path) -> None:
    shutil.copytree(Path(realsim.__file__).parent, tmp_path / "realsim", ignore=shutil.ignore_patterns("__pycache__"))
    gap = tmp_path / "realsim" / "gap"
    assert hash_of(tmp_path) == engine()
    (gap / "report" / "words.py").write_text("# another page")
    assert hash_of(tmp_path) == engine()
    effect = gap / "effects" / "bodies.py"
    effect.write_text(effect.read_text() + "\n# another law\n")
    assert hash_of(tmp_path) != engine()


def test_settings_that_cannot_change_an_answer_are_left_out() -> None:
    one, other = provenance(DiagnoseConfig(threads=1)), provenance(DiagnoseConfig(threads=7, report=False))
    assert one == other
    assert one != provenance(DiagnoseConfig(max_causes=2))
    assert json.loads(json.dumps(one))["version"] == realsim.__version__
