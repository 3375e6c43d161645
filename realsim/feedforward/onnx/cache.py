"""A model's raw outputs, kept by the content of model and inputs: a change of masks or modes does not run it again."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import RealsimError
from realsim.core.files import digest, read_npz, write_bytes

MAX_ENTRY_BYTES = 512 * 2**20
"""Larger outputs are not kept: reading them takes as long as running the model."""


class OutputCache:
    """Outputs by digest in a folder (as `model-DIGEST.npz`, trimmed with the other finished stages)."""

    def __init__(self, folder: Path | None, model: str) -> None:
        self.folder, self.model = folder, model

    def get_or_run(
        self, feeds: Mapping[str, NDArray], roles: Iterable[str], run: Callable[[], dict[str, NDArray]]
    ) -> dict[str, NDArray]:
        """The outputs by role for these inputs. A broken entry counts as absent."""
        if self.folder is None:
            return run()
        key = digest(self.model, *(part for item in sorted(feeds.items()) for part in item), sorted(roles))
        path = self.folder / f"model-{key}.npz"
        with contextlib.suppress(RealsimError, KeyError):
            store = read_npz(path)
            return {role: store[role] for role in roles}
        found = run()
        if sum(v.nbytes for v in found.values()) <= MAX_ENTRY_BYTES:
            data = io.BytesIO()
            np.savez(data, allow_pickle=False, **found)
            # A full or read-only disk must not spoil a result that is already there.
            with contextlib.suppress(RealsimError, OSError):
                write_bytes(path, data.getvalue())
        return found
