"""Pictures that move."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from trainer.replay import FORMATS, write_animation


@pytest.mark.parametrize("ending", [".gif", ".webp"])
def test_an_animation_has_its_frames_in_order(tmp_path: Path, ending: str) -> None:
    assert ending in FORMATS
    shades = [0, 200, 0]
    path = tmp_path / f"trial{ending}"
    write_animation([np.full((16, 24, 3), shade, np.uint8) for shade in [*shades, 200]], path, 5.0)
    with Image.open(path) as file:
        frames = [np.asarray(f.convert("RGB"), float) for f in ImageSequence.Iterator(file)]
        assert file.info["loop"] == 0
    assert [f.shape for f in frames] == [(16, 24, 3)] * 4
    assert [round(float(f.mean())) for f in frames] == pytest.approx([*shades, 200], abs=4)
