"""A dictionary of tensors saved by PyTorch (.pt), as tools for sim-to-real identification publish them.

Never unpickled freely: `weights_only` admits tensors and plain containers, and refuses anything that could run.
"""

from pathlib import Path

import numpy as np

from realsim.core.errors import GapError, extra
from realsim.core.files import archive_damage, check_size
from realsim.gap.recordings.recording import Reader, Recording, has_suffix, no_samples, readable
from realsim.gap.recordings.tables import of_arrays


def read(path: Path) -> list[Recording]:
    torch = extra("torch", "train", "reading .pt")
    check_size(path)
    if (damage := archive_damage(path)) is not None:
        raise GapError("the file is damaged", file=path, found=damage, hint="copy it again")
    with readable(path, ".pt file", "a dictionary of tensors"):
        value = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(value, dict):
        raise no_samples(path, "a dictionary of tensors")
    arrays = {str(k): np.asarray(v, dtype=np.float64) for k, v in value.items() if torch.is_tensor(v)}
    return [Recording(path, path.stem, "torch", (of_arrays(path, arrays),))]


READER = Reader("torch", "a .pt file with a dictionary of tensors", has_suffix(".pt", ".pth"), read)
