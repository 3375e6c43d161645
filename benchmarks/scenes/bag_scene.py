"""The same frames as a folder and as a bag: what `realsim reconstruct` makes of both.

    python benchmarks/scenes/bag_scene.py [--terrains stakes boxes] [--frames 60]

Renders a capture with sensor noise and poses (`realsim synth`), writes its frames into an MCAP file as a ROS 2 robot
with a depth camera records them (16-bit depth, JPEG colour, camera infos, tf), and reconstructs both. The bag is
written with the package `rosbags`, by the writer of the tests: files of our own, not a robot's. Rows go to
benchmarks/results/bag_scene.json.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from benchmarks.store import Store
from realsim.capture import CaptureConfig, read
from realsim.core.types import FrameSet
from realsim.export.config import SceneConfig
from realsim.pipeline import ReconstructConfig, reconstruct
from realsim.synth.capture import write_capture
from realsim.synth.config import SynthConfig
from realsim.synth.errors import compare
from tests.capture.rosbags_of import write_bag
from tests.capture.scene import View

RESULTS = Path(__file__).parents[1] / "results" / "bag_scene.json"
FRAMES_A_SECOND = 10.0
SHOWN = ("scale_error", "tilt_deg", "yaw_deg", "origin_mm", "tops_mm", "f_score_1cm", "f_score_2cm")


def as_bag(frames: FrameSet, path: Path, truth: Path) -> Path:
    """An MCAP file with the frames, their cameras and poses: in a world whose z is up, as ROS has it (REP 103)."""
    T_sim_world = np.asarray(json.loads((truth / "truth.json").read_text())["T_sim_world"])
    views = []
    for i, frame in enumerate(frames.frames):
        color = frame.color()
        assert color is not None
        assert frame.T_world_camera is not None
        at = 1_700_000_000.0 + i / FRAMES_A_SECOND
        views.append(View(T_sim_world @ frame.T_world_camera, frame.depth(), color, at))
    camera = frames.frames[0].intrinsics
    return write_bag(path, views, storage="mcap_file", color="jpeg", intrinsics=camera)


def measure(terrain: str, count: int, work: Path) -> list[dict[str, Any]]:
    """A row for the folder and one for the bag."""
    made = write_capture(work / "made", SynthConfig(terrain, count, poses=True))
    frames = read(made.capture, CaptureConfig())
    assert isinstance(frames, FrameSet)
    bag = as_bag(frames, work / "walk.mcap", made.truth)
    rows = []
    for source, path in (("folder", made.capture), ("bag", bag)):
        began = time.process_time()
        config = ReconstructConfig(cache=work / f"cache_{source}", scene=SceneConfig(contact_probes=300))
        scene = reconstruct(path, work / source, config)
        report = json.loads((scene.scene.folder / "report.json").read_text())
        errors = compare(scene.scene.folder, made.truth)
        rows.append(
            {
                "terrain": terrain,
                "frames": count,
                "source": source,
                "megabytes": round(sum(f.stat().st_size for f in _files(path)) / 1e6, 1),
                "verdict": report["verdict"]["level"],
                **{name: round(float(errors[name]), 4) for name in SHOWN},
                "cpu_seconds": round(time.process_time() - began, 1),
            }
        )
    return rows


def _files(path: Path) -> list[Path]:
    return [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file()]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--terrains", nargs="+", default=["stakes", "boxes"])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    store = Store(args.store, ("terrain", "frames", "source"))
    for terrain in args.terrains:
        with tempfile.TemporaryDirectory() as work:
            for row in measure(terrain, args.frames, Path(work)):
                print(json.dumps(store.add(row)), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
