"""The exact terrains of the benchmarks are test data here; `pytest` alone does not put the repository on the path."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
