"""The tutorials tell the commands that their pictures were made with, and every picture is there and small."""

import re
from pathlib import Path

import pytest

from tools.docs_pictures import IMAGES, MOST_BYTES, MOST_BYTES_MOVING, PICTURES, STEPS

DOCS = Path(__file__).resolve().parents[2] / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))


def test_every_command_stands_in_a_tutorial() -> None:
    told = {line for page in TUTORIALS for line in page.read_text().splitlines()}
    for commands in STEPS.values():
        for command in commands.splitlines():
            assert command in told


@pytest.mark.parametrize("picture", PICTURES, ids=lambda p: p.name)
def test_pictures_are_there_and_small(picture) -> None:
    most = MOST_BYTES_MOVING if picture.name.endswith(".webp") else MOST_BYTES
    assert (IMAGES / picture.name).stat().st_size <= most


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda p: p.stem)
def test_pictures_of_a_tutorial_exist(page: Path) -> None:
    names = re.findall(r"!\[[^\]]*\]\(\.\./images/([^)]+)\)", page.read_text())
    assert names
    assert all((IMAGES / name).is_file() for name in names)
