"""Labels of points: a small interface, so that a learned segmentation can replace the geometric one."""

from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from realsim.align.cloud import Cloud
from realsim.core.errors import AlignError
from realsim.core.registry import Registry

Labels = NDArray[np.uint8]


class Label(IntEnum):
    """Classes of points."""

    OTHER = 0
    """Walls, people, ceilings, noise: never part of the terrain."""
    GROUND = 1
    OBSTACLE = 2
    """Stands on the ground and is low enough to be climbed or stepped over."""
    PLATFORM = 3
    """A level top face large enough to stand on."""


SEGMENTERS = Registry("segmenter", {"geometric": "realsim.align.geometric:segment"}, "realsim.segmenters")
"""Name -> `Segmenter`. Installed packages add theirs as entry points `realsim.segmenters`."""


class Segmenter(Protocol):
    """A function from a levelled cloud to labels."""

    def __call__(self, cloud: Cloud) -> Labels:
        """Label a cloud whose z axis is up and whose ground is z = 0: (M,) uint8 of `Label`."""
        ...


def segmented(name: str, cloud: Cloud) -> Labels:
    """The labels of the segmenter `name`, checked.

    Raises:
        UnknownNameError: no such segmenter.
        AlignError: it returns something else than a label a point.
    """
    labels = np.asarray(SEGMENTERS[name](cloud))
    if labels.shape != (len(cloud),) or not np.isin(labels, list(Label)).all():
        raise AlignError(
            f"the segmenter {name!r} does not follow the contract of segmenters",
            expected=f"({len(cloud)},) labels out of {', '.join(f'{label.value} {label.name}' for label in Label)}",
            found=f"shape {labels.shape}, values {np.unique(labels)[:8].tolist()}",
        )
    return labels.astype(np.uint8)
