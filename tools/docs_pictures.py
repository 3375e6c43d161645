"""Makes the pictures of README and docs: runs the tutorials' commands and photographs what they made.

    python tools/docs_pictures.py WORK [NAME ...]

WORK keeps what the commands made; a step whose result is there is not run again. NAMEs choose pictures, by default all.
Needs chromium for the pictures of report pages.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from PIL import Image, ImageSequence

from realsim.core.types import U8
from realsim.report.picture import draw
from trainer.replay import write_animation

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
MOST_BYTES, MOST_BYTES_MOVING = 150_000, 400_000
EVERY, FPS = 4, 12.5 / 4
"""Of a .webp: one frame of so many that `realsim play` wrote, and how many a second."""

STEPS = {
    "synthetic": "realsim synth --terrain mixed --frames 40 --with-poses --out synthetic",
    "phone": "python examples/05_phone_capture.py synthetic phone",
    "phone_scene": "realsim reconstruct phone --out phone_scene --robot g1",
    "boston": "realsim synth --terrain boston --frames 10 --out boston",
    "scan.ply": "python examples/06_lidar_scan.py boston scan.ply",
    "scan_scene": "realsim reconstruct scan.ply --out scan_scene --robot g1",
    "servo": "python examples/07_servo_log.py servo",
    "servo_case": (
        "realsim diagnose --init servo/servo.xml --out servo_case\ncp -r servo/runs servo/columns.json servo_case/"
    ),
    "servo_diagnosis": "realsim diagnose servo_case --out servo_diagnosis",
    "quadruped": "python examples/08_quadruped_log.py quadruped",
    "quadruped_case": (
        "realsim diagnose --init quadruped/quadruped.xml --out quadruped_case\ncp -r quadruped/runs quadruped_case/"
    ),
    "quadruped_diagnosis": (
        "realsim diagnose quadruped_case --out quadruped_diagnosis --max-runs 4 "
        "--effects payload motor_gain coulomb_friction viscous_friction command_delay"
    ),
    "tuned": "realsim finetune phone_scene --device cpu --worlds 16 --iterations 4 --final-trials 8 --out tuned",
    "training.html": "realsim training report tuned --out training.html",
    "stakes": (
        "python benchmarks/training/ttt.py prepare --sources rgbd --tests stake3 --work stakes --store stakes/rows.json"
    ),
    "crossing.webp": (
        "realsim play stakes/scenes/rgbd/stake3/scene --policy trainer/policies/g1_parkour.pt --out crossing.webp"
    ),
    "trial.mp4": "realsim play phone_scene --policy tuned/policy.pt --out trial.mp4",
}
"""What a step makes -> its commands, as the tutorials have them, run in WORK with the repository's examples/ beside."""


@dataclass(frozen=True)
class Picture:
    """A picture of the docs."""

    name: str
    needs: tuple[str, ...]
    """Steps in the order in which they are run."""
    take: Callable[[Path], U8]
    """WORK -> (H, W, 3) RGB; of a .webp (T, H, W, 3)."""


def page(html: str, top: int, bottom: int, left: int = 60, right: int = 1220) -> Callable[[Path], U8]:
    """A photograph of a part of a report page, in the page's pixels at a width of 1280."""

    def take(work: Path) -> U8:
        with TemporaryDirectory() as folder:
            command = ["chromium", "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--hide-scrollbars"]
            command += [
                "--enable-unsafe-swiftshader",
                "--virtual-time-budget=8000",
                f"--window-size=1280,{bottom + 20}",
            ]
            command += [f"--user-data-dir={folder}/profile", f"--window-size=1280,{bottom + 20}"]
            command += [f"--screenshot={folder}/page.png", f"file://{work / html}"]
            subprocess.run(command, check=True, capture_output=True, timeout=300)
            return _rgb(cv2.imread(f"{folder}/page.png"))[top:bottom, left:right]

    return take


def scene(folder: str) -> Callable[[Path], U8]:
    """The scene as MuJoCo draws it."""
    return lambda work: draw(work / folder / "scene.xml", 1200, 720)


def frame_and_scene(work: Path) -> U8:
    """A camera frame beside the scene that was made of it."""
    frame = _rgb(cv2.imread(str(work / "phone" / "frame_00001.jpg")))
    return _beside([frame, draw(work / "phone_scene" / "scene.xml", 960, 720)], 440)


def trial(work: Path) -> U8:
    """Four moments of a trial."""
    video = cv2.VideoCapture(str(work / "trial.mp4"))
    frames = []
    while (read := video.read())[0]:
        frames.append(_rgb(read[1]))
    return _beside([frames[int(k * (len(frames) - 1))] for k in (0.0, 0.4, 0.7, 0.95)], 280)


def crossing(work: Path) -> U8:
    """What the camera saw, beside the robot on the scene that was made of it."""
    color = work / "stakes" / "scenes" / "rgbd" / "stake3" / "frames" / "capture" / "color"
    seen = [_rgb(cv2.imread(str(f))) for f in sorted(color.iterdir())]
    video = Image.open(work / "crossing.webp")
    robot = [np.asarray(f.convert("RGB")) for f in ImageSequence.Iterator(video)]
    shown = range(0, len(robot), EVERY)
    return np.stack([_beside([seen[i * len(seen) // len(robot)], robot[i]], 176) for i in shown])


PHONE = ("synthetic", "phone", "phone_scene")
SCAN = ("boston", "scan.ply", "scan_scene")
SERVO = ("servo", "servo_case", "servo_diagnosis")
QUADRUPED = ("quadruped", "quadruped_case", "quadruped_diagnosis")
TUNED = (*PHONE, "tuned")
PICTURES = (
    Picture("demo.jpg", PHONE, frame_and_scene),
    Picture("crossing.webp", ("stakes", "crossing.webp"), crossing),
    Picture("diagnosis.jpg", SERVO, page("servo_diagnosis/report.html", 0, 965)),
    Picture("tutorials/phone_report.jpg", PHONE, page("phone_scene/report.html", 0, 935)),
    Picture("tutorials/phone_map.jpg", PHONE, page("phone_scene/report.html", 940, 2010)),
    Picture("tutorials/scan_scene.jpg", SCAN, scene("scan_scene")),
    Picture("tutorials/scan_report.jpg", SCAN, page("scan_scene/report.html", 780, 1860)),
    Picture("tutorials/quadruped_report.jpg", QUADRUPED, page("quadruped_diagnosis/report.html", 0, 1080)),
    Picture("tutorials/training.jpg", (*TUNED, "training.html"), page("training.html", 0, 1000)),
    Picture("tutorials/trial.jpg", (*TUNED, "trial.mp4"), trial),
)


def main(work: Path, names: list[str]) -> None:
    work = work.absolute()
    work.mkdir(parents=True, exist_ok=True)
    for picture in PICTURES:
        if names and picture.name not in names and Path(picture.name).stem not in names:
            continue
        for step in picture.needs:
            run(step, work)
        _write(IMAGES / picture.name, picture.take(work))


def run(step: str, work: Path) -> None:
    """Run a step's commands unless its result is there."""
    if (work / step).exists():
        return
    for command in STEPS[step].splitlines():
        print(f"$ {command}", flush=True)
        own = ("examples/", "benchmarks/", "trainer/")
        words = [str(ROOT / word) if word.startswith(own) else word for word in command.split()]
        if words[0] == "python":
            words[0] = sys.executable
        elif words[0] == "realsim":
            words[:1] = [sys.executable, "-m", "realsim"]
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        subprocess.run(words, cwd=work, check=True, env=os.environ | {"PYTHONPATH": path})


def _rgb(image: np.ndarray | None) -> U8:
    assert image is not None
    return np.ascontiguousarray(image[..., ::-1], np.uint8)


def _beside(images: list[U8], height: int) -> U8:
    """Images at a common height, side by side with a white line between."""
    parts: list[U8] = []
    for image in images:
        width = round(image.shape[1] * height / image.shape[0])
        resized = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        parts += [np.full((height, 8, 3), 255, np.uint8), np.asarray(resized, np.uint8)]
    return np.hstack(parts[1:])


def _write(path: Path, image: U8) -> None:
    """As JPEG, at the best quality that keeps it small; several as .webp, as `realsim play` writes them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if image.ndim == 4:
        write_animation(list(image), path, FPS)
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB", flush=True)
        return
    for quality in (88, 80, 72, 64, 56):
        _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        if len(data) <= MOST_BYTES:
            break
    path.write_bytes(data.tobytes())
    print(f"{path.relative_to(ROOT)}: {len(data) / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1].startswith("-") or shutil.which("chromium") is None:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), sys.argv[2:])
