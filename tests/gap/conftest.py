"""Cases that the tests make themselves, each once a session."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from .truth import ARM, Truth, make_case


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """`made("name", Truth(...))` is the folder of that case, three short runs of the two-link arm."""
    root = tmp_path_factory.mktemp("gap")

    def make(name: str, truth: Truth, xml: str = ARM, **options: object) -> Path:
        folder = root / name
        if not folder.exists():
            make_case(folder, xml, truth, **{"runs": 4, "seed": 3, "span": (3.2, 4.0), **options})  # type: ignore[arg-type]
        return folder

    return make
