"""A stand-in for pyrealsense2 with the part of its interface that is used. Its `.bag` files are NumPy archives."""

import io
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from .scene import CAMERA, View

stream = SimpleNamespace(depth="stream.depth", color="stream.color")
format = SimpleNamespace(z16="format.z16", rgb8="format.rgb8", bgr8="format.bgr8")
camera_info = SimpleNamespace(name="name", serial_number="serial")
plugged_in: list[View] = []
"""What a live camera sees: these views again and again."""
breaks_after: list[int] = []
"""The camera is unplugged after so many images, if anything is in here."""
interrupts_after: list[int] = []
"""A person presses Ctrl-C after so many images."""
calls: list[str] = []
"""What was asked of cameras."""
color_format = [format.rgb8]


def write_bag(path: Path, views: Sequence[View], unit: float = 0.001) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    depth = np.array([np.rint(v.depth / unit) for v in views], np.uint16)
    data = io.BytesIO()
    np.savez(data, depth=depth, color=np.array([v.color for v in views]), time=[v.time for v in views], unit=unit)
    path.write_bytes(data.getvalue())


class config:
    def __init__(self) -> None:
        self.file: str | None = None

    def enable_device_from_file(self, file: str, repeat_playback: bool = True) -> None:
        assert not repeat_playback, "a recording that repeats never ends"
        self.file = file

    def enable_device(self, serial: str) -> None:
        calls.append(f"device {serial}")

    def enable_stream(self, which: str, width: int, height: int, kind: str, fps: int) -> None:
        calls.append(f"{which} {width}x{height} {kind} {fps}")


class pipeline:
    def start(self, asked: config) -> SimpleNamespace:
        self.live = asked.file is None
        if asked.file is None:
            if not plugged_in:
                raise RuntimeError("No device connected")
            views = plugged_in
            self.depth = np.array([np.rint(1000 * v.depth) for v in views], np.uint16)
            self.color, self.time, unit = [v.color for v in views], [v.time for v in views], 0.001
        else:
            try:
                with np.load(asked.file, allow_pickle=False) as data:
                    self.depth, self.color = data["depth"], data["color"]
                    self.time, unit = data["time"], float(data["unit"])
                if not len(self.depth) == len(self.color) == len(self.time):
                    raise ValueError("lengths")
            except Exception as error:
                raise RuntimeError(f"Failed to create ros reader: {error}") from error
        self.at = 0
        self.running = True
        return SimpleNamespace(get_device=lambda: device(unit), get_stream=self._stream)

    def _stream(self, which: str) -> SimpleNamespace:
        c = CAMERA
        intrinsics = SimpleNamespace(
            width=c.width,
            height=c.height,
            fx=c.fx,
            fy=c.fy,
            ppx=c.cx,
            ppy=c.cy,
            model="distortion.inverse_brown_conrady",
            coeffs=[0.0] * 5,
        )
        return SimpleNamespace(as_video_stream_profile=lambda: SimpleNamespace(get_intrinsics=lambda: intrinsics))

    def try_wait_for_frames(self, timeout_ms: int) -> tuple[bool, Any]:
        assert self.running
        if self.live and interrupts_after and self.at == interrupts_after[0]:
            raise KeyboardInterrupt
        if self.live and breaks_after and self.at == breaks_after[0]:
            raise RuntimeError("Device disconnected")
        if not self.live and self.at == len(self.depth):
            return False, None
        k = self.at % len(self.depth)
        frames = SimpleNamespace(depth=self.depth[k], color=self.color[k], number=self.at, time=self.at * 0.1)
        self.at += 1
        return True, frames

    def stop(self) -> None:
        self.running = False


class align:
    def __init__(self, to: str) -> None:
        assert to == stream.color

    def process(self, frames: SimpleNamespace) -> SimpleNamespace:
        return SimpleNamespace(
            get_depth_frame=lambda: frame(frames.depth, frames, format.z16),
            get_color_frame=lambda: frame(frames.color, frames, color_format[0]),
        )


class frame:
    def __init__(self, data: np.ndarray, frames: SimpleNamespace, kind: str) -> None:
        self.data, self.frames = data, frames
        self.profile = SimpleNamespace(format=lambda: kind)

    def get_data(self) -> np.ndarray:
        return self.data

    def get_frame_number(self) -> int:
        return self.frames.number

    def get_timestamp(self) -> float:
        return 1000 * self.frames.time


class device:
    def __init__(self, unit: float) -> None:
        self.unit = unit

    def first_depth_sensor(self) -> SimpleNamespace:
        return SimpleNamespace(get_depth_scale=lambda: self.unit)

    def as_playback(self) -> SimpleNamespace:
        return SimpleNamespace(set_real_time=lambda real: calls.append(f"real time {real}"))

    def get_info(self, which: str) -> str:
        return {"name": "Intel RealSense D435", "serial": "0123"}[which]
