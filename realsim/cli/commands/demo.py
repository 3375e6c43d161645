"""`realsim demo`: the main job end to end on an embedded default, measured against a truth that is known."""

import os
import shutil
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import tyro

from realsim import pipeline, robots
from realsim.cli.commands import CommandResult, verdict_lines
from realsim.core.errors import RealsimError
from realsim.core.files import read_json
from realsim.core.progress import note


def demo(
    out: Path = Path("demo_out"),
    terrain: Annotated[str, tyro.conf.arg(metavar="{stakes,beams,wedges,boxes,trapezoids,boston,mixed}")] = "stakes",
    frames: int = 60,
    poses: Annotated[bool, tyro.conf.arg(name="with-poses")] = False,
    robot: Annotated[str | None, tyro.conf.arg(metavar="{g1,go2,quadruped,menagerie:NAME}")] = "g1",
    seed: int = 0,
    overwrite: bool = False,
) -> CommandResult:
    """Render a terrain as a depth camera would see it, reconstruct it from the frames alone, and measure the errors.

    Args:
        out: gets frames/ (capture and truth) and scene/ (the reconstruction).
        terrain: the terrain between the platforms.
        frames: views along the walk.
        poses: give the reconstruction the camera poses as well.
        robot: robot to put on the start platform.
        seed: of the terrain, the walk, the sensor's noise and the reconstruction.
        overwrite: replace a folder that realsim wrote before.
    """
    from realsim.export.config import SceneConfig
    from realsim.report.verdict import judge
    from realsim.synth.capture import write_capture
    from realsim.synth.config import SynthConfig
    from realsim.synth.errors import compare

    if out.exists() and not out.is_dir():
        raise RealsimError(
            "the output is a file", file=out, expected="a folder that does not exist yet", hint="choose another --out"
        )
    if out.exists() and any(out.iterdir()) and not overwrite:
        raise RealsimError("the output folder exists and is not empty", file=out, hint="pass --overwrite")
    if robot is not None:
        robots.load(robot)  # before minutes of work
    note(f"rendering {frames} frames of the {terrain} terrain ...")
    began = time.perf_counter()
    synth = SynthConfig(terrain=terrain, frames=frames, poses=poses, seed=seed)
    made = write_capture(out / "frames", synth, overwrite=True)
    rendered = time.perf_counter() - began
    config = pipeline.ReconstructConfig(scene=SceneConfig(robot=robot), seed=seed, overwrite=True)
    result = pipeline.reconstruct(made.capture, out / "scene", config)
    seconds = sum(s.seconds for s in result.stages)
    reused = sum(s.reused for s in result.stages)
    errors = compare(out / "scene", made.truth)
    sensor = float(read_json(made.truth / "truth.json")["depth_scale"])
    verdict = judge(result).as_dict()
    lines = [
        *verdict_lines(verdict),
        "",
        f"rendered {frames} frames in {rendered:.1f} s, reconstructed them in {seconds:.1f} s"
        + (f" ({reused} of {len(result.stages)} stages kept from an earlier run)" if reused else "")
        + ("" if poses else ", camera poses unknown"),
        "",
        *_table(errors, sensor, poses),
        "",
        f"report  {out / 'scene' / 'report.html'}   open it in a browser",
        f"scene   {out / 'scene' / 'scene.xml'}   {_python()} -m mujoco.viewer --mjcf={out / 'scene' / 'scene.xml'}",
    ]
    data = {"verdict": verdict, "errors": errors, "sensor_scale": sensor, "seconds": seconds}
    data |= {"scene": str(out / "scene")}
    return CommandResult("\n".join(lines), data, level=verdict["level"])


def _python() -> str:
    """What to type for the Python that has MuJoCo: `make demo` runs one that is on nobody's PATH."""
    if shutil.which("python") == sys.executable:
        return "python"
    return min(sys.executable, os.path.relpath(sys.executable), key=len)


def _table(errors: dict[str, Any], sensor: float, poses: bool) -> list[str]:
    """The measured errors against the known truth, one a line."""
    remark = "recovered from the poses" if poses else "cannot be determined from the frames alone"
    rows = [
        (
            "scale error",
            f"{100 * errors['scale_error']:.2f} %",
            f"the sensor's own is {100 * abs(sensor - 1):.2f} %: {remark}",
        ),
        ("tilt error", f"{errors['tilt_deg']:.3f} degrees", ""),
        ("heading error", f"{abs(errors['yaw_deg']):.3f} degrees", ""),
        ("origin error", f"{errors['origin_mm']:.1f} mm", ""),
        ("tops of obstacles", f"{errors['tops_mm']:.1f} mm", "median height error after rigid registration"),
        ("F-score at 1 cm", f"{errors['f_score_1cm']:.3f}", "after rigid registration"),
        ("F-score at 2 cm", f"{errors['f_score_2cm']:.3f}", ""),
    ]
    return [f"  {name:<18} {value:<14} {remark}".rstrip() for name, value, remark in rows]
