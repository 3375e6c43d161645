"""Record3D's export "EXR + RGB": rgb/0.jpg, depth/0.exr, metadata.json, perhaps inside EXR_RGBD/.

Depth is one float channel in metres, NaN where invalid; the metadata are those of a `.r3d`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from realsim.capture.assemble import require_both
from realsim.capture.config import CaptureConfig
from realsim.capture.images import COLOR_SUFFIXES, MAX_IMAGE_BYTES, MAX_PIXELS, ColorImage, common_size, metres
from realsim.capture.intrinsics import no_intrinsics
from realsim.capture.layout import PHONE, Layout, Recognition
from realsim.capture.layouts.record3d import Pictures, frame_set, read_metadata
from realsim.capture.listing import list_files
from realsim.core.errors import CaptureError, RealsimError, extra
from realsim.core.files import check_size, read_json
from realsim.core.types import F32, FrameSet


@dataclass(frozen=True)
class ExrDepth:
    """`()` -> (H, W) float32 metres, 0 where invalid: the only channel of an EXR image, or R, Z or Y."""

    path: Path

    def __call__(self) -> F32:
        import OpenEXR

        check_size(self.path, MAX_IMAGE_BYTES)
        try:
            # The header first: it says how much the pixels need.
            with OpenEXR.File(str(self.path), header_only=True) as file:
                low, high = file.header()["dataWindow"]
            width, height = (int(v) for v in high.astype(int) - low.astype(int) + 1)
            if min(width, height) < 1 or width * height > MAX_PIXELS:
                raise CaptureError("an impossible image size", file=self.path, found=f"{width}x{height}")
            with OpenEXR.File(str(self.path), separate_channels=True) as file:
                channels = {name: channel.pixels for name, channel in file.channels().items()}
        except RealsimError:
            raise
        except Exception as error:  # the library raises RuntimeError, ValueError and its own kinds for damaged files
            raise CaptureError("corrupt or truncated image", file=self.path, found=str(error)) from error
        name = next((n for n in ("R", "Z", "Y") if n in channels), None) or next(iter(channels), None)
        if name is None or channels[name].ndim != 2 or channels[name].dtype.kind != "f":
            raise CaptureError("depth of another type", file=self.path, expected="a float channel R, Z or Y")
        return metres(np.asarray(channels[name], np.float32))


def root_of(folder: Path) -> Path:
    return folder / "EXR_RGBD" if (folder / "EXR_RGBD").is_dir() else folder


def metadata_file(root: Path) -> Path | None:
    """`metadata.json`, also as a browser renames it: `metadata (1).json`."""
    return next(iter(sorted(root.glob("metadata*.json"))), None)


def recognise(folder: Path) -> Recognition:
    root = root_of(folder)
    depth = list_files(root / "depth", (".exr",))
    if not depth:
        return Recognition()
    missing = [] if metadata_file(root) else ["intrinsics (metadata.json)"]
    if not list_files(root / "rgb", COLOR_SUFFIXES):
        missing.append("colour images (rgb/)")
    return Recognition((f"{len(depth)} x depth/*.exr",), tuple(missing), score=35)


def read(folder: Path, config: CaptureConfig) -> FrameSet:
    root = root_of(folder)
    depth = {int(p.stem): p for p in list_files(root / "depth", (".exr",)) if p.stem.isdigit()}
    color = {int(p.stem): p for p in list_files(root / "rgb", COLOR_SUFFIXES) if p.stem.isdigit()}
    source = metadata_file(root)
    require_both(color, depth, root, "rgb/0.jpg and depth/0.exr and so on")
    if source is None:
        raise no_intrinsics(root, ("metadata.json",), "export the recording again, with its metadata.json")
    extra("OpenEXR", "phone", "reading Record3D's EXR depth")
    meta = read_metadata(read_json(source), source, config)
    depth_size = common_size(ExrDepth(p) for p in depth.values())
    if depth_size is None:
        raise CaptureError("no depth image can be read", file=root / "depth", expected="float EXR images")

    def pictures(number: int) -> Pictures:
        if number not in depth or number not in color:
            raise CaptureError("depth without colour" if number in depth else "colour without depth")
        files = (color[number], depth[number])
        return Pictures(ExrDepth(depth[number]), ColorImage(color[number]), None, files)

    return frame_set(folder, LAYOUT.name, sorted(depth.keys() | color.keys()), meta, depth_size, pictures)


LAYOUT = Layout("record3d_exr", "depth/*.exr, rgb/ and metadata.json: Record3D's EXR export", recognise, read, PHONE)
