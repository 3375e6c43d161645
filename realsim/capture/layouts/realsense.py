"""A RealSense recording (`.bag`), read through pyrealsense2.

The library can only play a recording from its start, and frames here are requested in any order. So a recording is
unpacked once, into the user's cache folder, and read from there; a changed recording is unpacked anew.
"""

from dataclasses import replace
from pathlib import Path

from realsim.capture.config import CaptureConfig
from realsim.capture.layout import Layout, Recognition
from realsim.capture.layouts import plain
from realsim.capture.listing import single_file
from realsim.capture.realsense import library, open_bag
from realsim.capture.record import write_frames
from realsim.core.cache import default_folder
from realsim.core.errors import CaptureError
from realsim.core.files import check_size, digest, output_folder
from realsim.core.progress import track
from realsim.core.types import FrameSet

MAX_BAG_BYTES = 256 * 2**30


def recognise(path: Path) -> Recognition:
    found = single_file(path, (".bag",))
    return Recognition() if found is None else Recognition((found.name,), (), score=40)


def read(path: Path, config: CaptureConfig) -> FrameSet:
    source = single_file(path, (".bag",))
    if source is None:
        raise CaptureError("no .bag file", file=path, expected="one .bag file, or a folder that holds one")
    folder = unpacked(source)
    capture = plain.read(folder, config)
    notes = [f"the recording was unpacked into {folder}", "depth is registered to colour by the camera's calibration"]
    return replace(capture, source=path, layout=LAYOUT.name, assumptions=(*notes, *capture.assumptions))


def unpacked(source: Path) -> Path:
    """The folder with the recording's frames in layout `plain`; unpacked now if it is not there yet.

    Raises:
        MissingExtraError: pyrealsense2 is not installed.
        CaptureError: not a recording, without colour or depth, or without any frame.
    """
    check_size(source, MAX_BAG_BYTES)
    facts = source.stat()
    key = digest(str(source.resolve()), facts.st_size, facts.st_mtime_ns)[:16]
    folder = default_folder() / "bags" / f"{source.stem}-{key}"
    if folder.is_dir():
        return folder
    with output_folder(folder) as work, open_bag(source, library()) as stream:
        count = sum(1 for _ in track(write_frames(work, stream, stream.shots), f"unpacking {source.name}"))
        if not count:
            raise CaptureError("no frame in this recording", file=source)
    return folder


LAYOUT = Layout("realsense", "a .bag file recorded with a RealSense camera (extra realsense)", recognise, read)
