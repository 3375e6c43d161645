"""How long the way from frames to a tuned policy takes: the clock of `examples/parkour.py`, kept as rows.

    python benchmarks/training/parkour.py --part scene --out way  CPU: stake1 is rendered, then reconstructed
    python benchmarks/training/parkour.py --part policy --scene way/scene --out way   GPU: tried, tuned, tried again

In two parts, because few machines have both Open3D and a GPU. Rendering the frames is not counted, and there are no
videos.
"""

import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tyro

from benchmarks.store import Store

ROOT = Path(__file__).resolve().parents[2]
KEY = ("course", "part", "minutes")


@dataclass(frozen=True)
class Options:
    part: Literal["scene", "policy"]
    course: str = "stake1"
    scene: Path | None = None
    """The reconstructed course, for the second part."""
    minutes: float = 3.0
    """Of fine-tuning, at most: it ends once 97 % of the trials on the way succeed."""
    out: Path = Path("way")
    store: Path = ROOT / "benchmarks" / "results" / "parkour.json"


def main(options: Options) -> None:
    measured = scene if options.part == "scene" else policy
    row = {"course": options.course, "part": options.part, **measured(options)}
    print(json.dumps(Store(options.store, KEY).add(row)))


def scene(options: Options) -> dict[str, Any]:
    """Frames to scene."""
    import realsim as rs
    from realsim.synth.capture import write_capture
    from realsim.synth.config import SynthConfig
    from trainer import terrain
    from trainer.terrain.rendered import in_room

    course = in_room(terrain.named(options.course))
    capture = write_capture(options.out / "frames", SynthConfig(), terrain=course, overwrite=True).capture
    began = time.perf_counter()
    found = rs.reconstruct(capture, options.out / "scene", overwrite=True)
    seconds = round(time.perf_counter() - began, 1)
    return {"minutes": 0.0, "frames": SynthConfig().frames, "verdict": found.verdict, "seconds": {"scene": seconds}}


def policy(options: Options) -> dict[str, Any]:
    """Scene to tuned policy, by the example itself."""
    if options.scene is None:
        raise SystemExit("--scene is missing: the folder that the first part wrote (OUT/scene)")
    command = [sys.executable, ROOT / "examples" / "parkour.py", "--scene", options.scene, "--no-videos"]
    command += ["--minutes", options.minutes, "--out", options.out]
    subprocess.run(list(map(str, command)), check=True)
    return {"minutes": options.minutes, **json.loads((options.out / "clock.json").read_text())}


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
