"""A contact sheet of generated scenes: pictures, true depth, sensor depth; a row a scene.

python -m training.pointmap.sheet scenes.png --kind course --seed 3
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from realsim.core.errors import RealsimError
from realsim.core.files import write_bytes
from training.pointmap.layouts import LAYOUTS, library
from training.pointmap.scenes import Batch, Generator

FAR = 6.0
"""Metres that are white."""


def sheet(batch: Batch) -> np.ndarray:
    """(B H, (V + 2) W, 3) uint8: all views of each scene, then true and sensor depth of the first, near black."""
    pictures = (255 * batch.images).round().byte().permute(0, 1, 3, 4, 2).numpy()
    maps = [
        (255 * (z[:, 0] / FAR).clamp(0, 1)).byte()[..., None].expand(-1, -1, -1, 3) for z in (batch.depth, batch.sensor)
    ]
    rows = [np.concatenate([*p, *(m[i].numpy() for m in maps)], 1) for i, p in enumerate(pictures)]
    return np.concatenate(rows, 0)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="a .png")
    parser.add_argument("--kind", choices=[*LAYOUTS, "all"], default="all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--size", type=int, nargs=2, default=(120, 160))
    o = parser.parse_args()
    try:
        import cv2

        kinds = tuple(LAYOUTS) if o.kind == "all" else (o.kind,)
        batch = Generator(library(4 * o.scenes, o.seed, kinds), o.seed).batch(0, o.scenes, o.views, tuple(o.size))
        ok, data = cv2.imencode(".png", sheet(batch)[..., ::-1])
        if not ok:
            raise RealsimError("the picture cannot be encoded", file=o.out)
        write_bytes(o.out, data.tobytes())
    except ImportError:
        print("a contact sheet needs OpenCV: pip install opencv-python-headless", file=sys.stderr)
        sys.exit(2)
    except RealsimError as error:
        print(error.render(), file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
