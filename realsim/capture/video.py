"""Frames of a video by number, exactly, although decoders only go forward.

A decoder is kept open per process and shared by its threads. It remembers when each frame was shown, so that after a
jump back the frame that comes is known to be the right one; where seeking misses (variable frame rates), the file is
read again from the start.
"""

import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import CaptureError
from realsim.core.files import check_size
from realsim.core.types import U8

MAX_VIDEO_BYTES = 64 * 2**30
REMEMBERED = 6
"""Decoded frames that are kept: neighbours are requested from two threads, not quite in order."""
SAME_FRAME_MS = 0.5


@dataclass(frozen=True)
class VideoFrame:
    """A reader of one frame: `()` -> (h, w, 3) uint8 RGB as stored. Picklable, holds no decoder."""

    path: Path
    number: int

    def __call__(self) -> U8:
        return open_video(self.path).frame(self.number)


class Video:
    """One open video file.

    Raises:
        CaptureError: it cannot be decoded at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._recent: OrderedDict[int, U8] = OrderedDict()
        self._shown_ms: list[float] = []
        self._start()
        import cv2

        self.size = (
            int(self._decoder.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._decoder.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )
        self.count = int(self._decoder.get(cv2.CAP_PROP_FRAME_COUNT))
        """Frames as the container says; a damaged file may have fewer."""

    def frame(self, number: int) -> U8:
        """(h, w, 3) RGB of a frame, counted from 0.

        Raises:
            CaptureError: the video ends before it, or is damaged there.
        """
        with self._lock:
            if number not in self._recent:
                if number < self._next:
                    self._go_back(number)
                while self._next <= number:
                    self._advance(keep=self._next > number - REMEMBERED)
            return self._recent[number]

    def _start(self) -> None:
        import cv2

        self._decoder: Any = cv2.VideoCapture(str(self.path))
        if not self._decoder.isOpened():
            raise CaptureError("the video cannot be decoded", file=self.path)
        # The depth images beside a video do not follow its rotation tag.
        self._decoder.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        self._next = 0

    def _advance(self, keep: bool) -> None:
        """Decode the next frame; convert and remember it only if it is wanted."""
        import cv2

        if not self._decoder.grab():
            raise CaptureError(f"the video ends before frame {self._next}", file=self.path)
        if self._next == len(self._shown_ms):
            self._shown_ms.append(self._decoder.get(cv2.CAP_PROP_POS_MSEC))
        if keep:
            self._remember(self._next)
        self._next += 1

    def _remember(self, number: int) -> None:
        import cv2

        good, bgr = self._decoder.retrieve()
        if not good or bgr is None:
            raise CaptureError(f"frame {number} of the video is damaged", file=self.path)
        self._recent[number] = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
        while len(self._recent) > REMEMBERED:
            self._recent.popitem(last=False)

    def _go_back(self, number: int) -> None:
        """Make `number` the next frame, by seeking where that lands right, else from the start."""
        import cv2

        self._recent.clear()
        self._decoder.set(cv2.CAP_PROP_POS_FRAMES, number)
        if self._decoder.grab():
            landed = abs(self._decoder.get(cv2.CAP_PROP_POS_MSEC) - self._shown_ms[number]) < SAME_FRAME_MS
            if landed:
                self._remember(number)
                self._next = number + 1
                return
        self._decoder.release()
        self._start()


def open_video(path: Path) -> Video:
    """The video, opened once per process."""
    check_size(path, MAX_VIDEO_BYTES)
    return _open(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _open(path: Path, changed: int) -> Video:
    return Video(path)
