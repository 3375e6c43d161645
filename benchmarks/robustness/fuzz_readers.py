"""How benchmarks/robustness/fuzz.py reads what it damaged: every reader of realsim, with all that it says.

One library is not the real one: `pyrealsense2`, which decodes a RealSense camera's own .bag, is replaced by the tests'
stand-in (tests/capture/fake_realsense.py), whose ".bag" is a NumPy archive. Trials of the source `realsense` therefore
damage and read that archive: they try realsim's recognition of the file and what it makes of the library's frames and
errors, and say nothing of how librealsense reads a damaged bag. Bags of ROS 1 and 2 and MCAP are real files, written
and read by the real libraries.
"""

import contextlib
import json
import math
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import RealsimError
from realsim.core.files import digest, read_json

TOLD = ("assumptions", "dropped", "notes", "reasons", "unused", "warnings")
"""Lists of warnings in a command's answer."""


@dataclass
class Reading:
    """What came of reading something."""

    found: dict[str, Any] = field(default_factory=dict)
    """Part -> its value: an array, a number, a text."""
    said: list[str] = field(default_factory=list)
    """Assumptions, warnings, frames that were dropped: everything that a user is told."""
    refused: list[str] = field(default_factory=list)
    shown: str = ""
    """The text for the terminal."""

    def get(self, name: str, read: Callable[..., Any], *args: Any) -> Any:
        """A value; None where it is refused with an error that a user can act on. Any other exception goes on."""
        try:
            return read(*args)
        except RealsimError as error:
            self.refused.append(f"{name}: {error.message}")
            self.shown += error.render() + "\n"
            return None

    def part(self, name: str, read: Callable[..., Any], *args: Any) -> Any:
        """`get`, and the value is one of those by which a change is noticed."""
        value = self.get(name, read, *args)
        self.found[name] = _plain(value)
        return value

    def attributes(self, of: Any, *names: str, at: str = "") -> None:
        """`part` of several attributes."""
        for name in names:
            value = attrgetter(name)(of)
            self.part(f"{name}{at}", lambda value=value: value)


def _plain(value: Any) -> Any:
    """What can be sent to other processes."""
    return value if value is None or isinstance(value, np.ndarray | float | int | str) else repr(value)


def _surface(points: Any, triangles: Any) -> np.ndarray:
    """(K, 9) corners of the triangles, each once, in an order that how they are numbered does not change."""
    corners = np.asarray(points, float)[np.asarray(triangles, int)]
    first = np.array([np.lexsort(c.T[::-1])[0] for c in corners])
    turned = np.stack([corners[np.arange(len(corners)), (first + k) % 3] for k in range(3)], axis=1)
    return np.unique(turned.reshape(-1, 9), axis=0)


# ---------------------------------------------------------------- captures and logs


def read_capture(folder: Path) -> Reading:
    """What `realsim inspect` does, and every image of every frame."""
    from realsim import capture
    from realsim.capture import CaptureConfig
    from realsim.core.types import Scan
    from tests.capture import fake_realsense

    sys.modules["pyrealsense2"] = fake_realsense  # type: ignore[assignment]
    reading = Reading()
    inspection = reading.get("inspection", capture.inspect, folder, CaptureConfig())
    if inspection is not None:
        reading.shown += inspection.render()
        reading.said += [*inspection.assumptions, *inspection.wrong]
    data = reading.get("capture", capture.read, folder, CaptureConfig())
    if data is None:
        return reading
    reading.said += [*data.assumptions, *data.warnings]
    if isinstance(data, Scan):
        if data.triangles is None:
            reading.attributes(data, "points")
        else:
            reading.part("surface", _surface, data.points, data.triangles)
        reading.attributes(data, "normals", "colors")
        return reading
    reading.said += [f"{d.name}: {d.reason}" for d in data.dropped]
    reading.part("number of frames", len, data)
    for i, frame in enumerate(data.frames):
        at = f" of frame {i}"
        reading.attributes(frame, "name", "timestamp", "T_world_camera", at=at)
        for which in ("intrinsics", "color_intrinsics"):  # where they are fitted, in which order frames come shows
            camera = getattr(frame, which)
            reading.part(f"{which}{at}", lambda c=camera: c and np.array(list(vars(c).values())).round(3))
        reading.part(f"depth{at}", frame.depth)
        reading.part(f"colour{at}", frame.color)
        reading.part(f"confidence{at}", frame.read_confidence or (lambda: None))
    return reading


def read_case(folder: Path) -> Reading:
    """What `realsim diagnose --check` does."""
    from realsim.gap.case.case import load_case
    from realsim.gap.case.health import examine
    from realsim.gap.config import DiagnoseConfig
    from realsim.gap.pipeline import limited
    from realsim.gap.simulation.simulate import Simulator

    reading, config = Reading(), DiagnoseConfig()
    case = reading.get("case", load_case, folder)
    if case is None:
        return reading
    reading.said += [*case.warnings, *case.dropped_runs]
    names = ("joint_names", "actuator_names", "command_kind", "base", "torque_kind", "imu_site", "contact_bodies")
    reading.attributes(case, *names)
    of_model = ("opt.timestep", "body_mass", "body_inertia", "body_pos", "jnt_range", "dof_damping", "geom_size")
    reading.attributes(case.model, *of_model, "actuator_gainprm", at=" of the model")
    for run in case.runs:
        reading.attributes(run, "time", "command", "setup", at=f" of {run.name}")
        for name, values in run.signals.items():
            reading.part(f"{name} of {run.name}", lambda values=values: values)

    def health() -> Any:
        with Simulator(limited(case, config), config) as simulator:
            return examine(simulator)

    found = reading.get("health", health)
    if found is not None:
        reading.said += map(str, found.get("warnings", []))
        reading.shown += json.dumps(found, default=str, ensure_ascii=True)
    return reading


def read_recording(folder: Path) -> Reading:
    """What `realsim log` does: the recording, what it is taken for, and the case that it becomes."""
    from realsim import gap
    from realsim.gap import recordings as logs

    reading = Reading()
    target = reading.get("target", logs.load_target, folder / "robot.xml")
    inside = sorted((folder / "log").iterdir()) if (folder / "log").is_dir() else []
    found = reading.get("recordings", logs.read, inside[0] if len(inside) == 1 else folder / "log")
    for recording in found or ():
        reading.said += [*recording.notes, *(f"{k}: {v}" for k, v in recording.skipped.items())]
        for stream in recording.streams:
            for name, item in stream.fields.items():
                reading.part(f"{name} of {stream.name or 'all'}", lambda item=item: item.values)
            for name, clock in stream.clocks.items():
                reading.part(f"clock {name} of {stream.name or 'all'}", lambda clock=clock: clock)
    proposal = None if found is None else reading.get("proposal", logs.propose, found, target)
    if proposal is None:
        return reading
    reading.shown += proposal.render()
    reading.said += [*proposal.missing, *proposal.warnings, *proposal.clocks]
    reading.said += [e for a in proposal.assignments.values() for e in a.evidence]
    if proposal.complete and target is not None:
        out = folder.parent / "written"
        shutil.rmtree(out, ignore_errors=True)
        notes = reading.get("written", logs.write_case, proposal, target, out)
        reading.said += notes or []
        if notes is not None:
            reading.part("runs of the case", lambda: len(gap.load_case(out).runs))
    return reading


# ---------------------------------------------------------------- policies, models, scenes, results


def read_other(folder: Path) -> Reading:
    """A folder with one of FILES, by its own reader."""
    names, reading = {p.name for p in folder.iterdir()}, Reading()
    if {"metadata.json", "contents.json"} & names:
        _put_back(folder)
    present = [name for name in FILES if name in names]
    for name in present or ["policy.onnx"]:  # the file is gone or renamed: what is not there is requested
        FILES[name](folder / name, reading)
    return reading


def _put_back(folder: Path) -> None:
    """Damaged metadata into the file that they belong to; what cannot be put there is left out."""
    with contextlib.suppress(Exception):  # onnx and torch raise what they like; the damage then is all there is
        if all((folder / name).is_file() for name in ("metadata.json", "policy.onnx")):
            import onnx

            model = onnx.load(folder / "policy.onnx")
            next(p for p in model.metadata_props if p.key == "realsim").value = (folder / "metadata.json").read_text()
            onnx.save(model, folder / "policy.onnx")
        elif all((folder / name).is_file() for name in ("contents.json", "policy.pt")):
            import torch

            data = torch.load(folder / "policy.pt", weights_only=True)
            plain = json.loads((folder / "contents.json").read_text())
            torch.save(data | plain if isinstance(plain, dict) else plain, folder / "policy.pt")


class _Robot:
    """Stands still and sees a wall; how many joints it has is told by the policy's gains."""

    def __init__(self, depth: Sequence[int] | None) -> None:
        self.joints, self.shape = 0, depth

    def start(self, kp: Any, kd: Any) -> None:
        self.joints = len(kp)

    def read(self) -> Any:
        from trainer.deploy.robot import Reading as Sensors

        still, down = np.zeros(self.joints), np.array([0.0, 0.0, -1.0])
        return Sensors(np.zeros(3), down, still, still, None if self.shape is None else np.ones(tuple(self.shape[1:])))

    def write(self, targets: Any) -> None:
        assert np.isfinite(targets).all()

    def stop(self) -> None:
        pass


def _policy_onnx(path: Path, reading: Reading) -> None:
    from trainer.commands.deploy import body_of
    from trainer.deploy.loop import DeployConfig, deploy
    from trainer.ppo import export

    loaded = reading.get("policy", export.load, path)
    if loaded is None:
        return
    session, facts = loaded
    reading.part("facts", lambda: facts)
    reading.get("robot", body_of, facts, path)
    config = DeployConfig(seconds=3.5 * facts.policy_dt, realtime=False)

    def drive() -> int:
        return deploy(_Robot(facts.layout.depth), session, facts, config, steer=lambda v: np.array([v, 0, 0])).steps

    reading.part("loop", drive)


def _policy_pt(path: Path, reading: Reading) -> None:
    import torch

    from trainer.ppo import checkpoint

    loaded = reading.get("policy", checkpoint.load, path)
    if loaded is None:
        return
    policy, layout = loaded[0], loaded[0].layout
    reading.attributes(policy, "layout", "robot", "networks", "tuned")
    depth = None if layout.depth is None else torch.zeros(1, *layout.depth)
    with torch.no_grad():
        reading.part("action", lambda: policy.actor(torch.zeros(1, layout.actor_width), depth).numpy().round(4))


def _model_onnx(path: Path, reading: Reading) -> None:
    from realsim.feedforward.onnx.inspect import inspect_model

    found = reading.get("model", inspect_model, path)
    if found is not None:
        text = found.render().replace(str(path), "")
        reading.found["model"] = text
        reading.said.append(text)
        reading.shown += text


def _scene(path: Path, reading: Reading) -> None:
    import realsim as rs
    from trainer.terrain.scene import load

    folder, out = path.parent, path.parents[2] / "exported"
    scene = reading.get("scene", rs.load_scene, folder)
    if scene is not None:
        reading.said += scene.warnings
        reading.attributes(scene, "contact", "verdict", "start", "goal")
        reading.part("page", lambda: len(scene._repr_html_()))
        reading.shown += repr(scene)
    shutil.rmtree(out, ignore_errors=True)
    for name in ("mjcf", "urdf", "obj", "heightmap", "terrain", "glb"):
        files = reading.get(f"export {name}", lambda name=name: rs.export(folder, name, out)[name])
        if files is not None:
            reading.found[f"exported {name}"] = digest(*files)
    terrain = reading.get("terrain", load, folder)
    if terrain is not None:
        reading.attributes(terrain, "start", "goal", "floor_z", "vertices", at=" of the terrain")


def _mesh(path: Path, reading: Reading) -> None:
    from realsim.export.ground import ground_level
    from realsim.export.mend import read_mesh

    made = reading.get("mesh", read_mesh, path)
    if made is not None:
        mesh = made.terrain
        reading.said += made.notes
        reading.part("surface", _surface, mesh.vertices, mesh.triangles)
        reading.part("ground", lambda: math.floor(1e6 * ground_level(mesh).z))


def _diagnosis(path: Path, reading: Reading) -> None:
    import mujoco

    import realsim as rs
    from tests.gap.truth import PENDULUM
    from trainer.robots import ROBOTS
    from trainer.tasks.parkour import gap

    known = reading.get("known to the trainer", gap.load, path, ROBOTS["quadruped"]())
    if known is not None:
        reading.part("known to the trainer", lambda: known)
        reading.said += known.unused
    found = reading.part("diagnosis", rs.load_diagnosis, path.parent)
    if found is not None:
        reading.part("page", found._repr_html_)
        reading.shown += repr(found)
        reading.part("patched", rs.apply_patch, mujoco.MjSpec.from_string(PENDULUM), found)


def _task(path: Path, reading: Reading) -> None:
    from trainer.commands.task_file import load_task

    reading.part("task", load_task, path)


def _training(path: Path, reading: Reading) -> None:
    from trainer.report.document import training_page
    from trainer.report.history import read_run

    run = reading.get("run", read_run, path.parent, "run")
    if run is not None:
        reading.said += run.notes
        reading.get("page", training_page, [run])
        for name, values in {**run.over, **run.columns}.items():
            reading.part(f"{name} of history", lambda values=values: values)


def read_request(folder: Path) -> Reading:
    """What `realsim mcp` does with a request; an error without a reason counts as a crash of the tool."""
    import asyncio

    import mcp

    from realsim.cli.mcp_server import build
    from realsim.cli.roots import Roots

    async def ask(tool: str, arguments: dict[str, Any]) -> Any:
        async with mcp.Client(build(Roots([folder]))) as client:
            return await client.call_tool(tool, arguments)

    reading = Reading()
    try:
        request = read_json(folder / "request.json")
        tool, arguments = str(request["tool"]), dict(request["arguments"])
    except (RealsimError, ValueError, LookupError, TypeError) as error:
        reading.refused.append(f"no request: {type(error).__name__}")  # the library's own affair
        return reading
    answer = asyncio.run(ask(tool, arguments))
    text = "\n".join(part.text for part in answer.content)
    if answer.is_error:
        assert not re.match(r"Error executing tool \w+$|the command ended without", text), text
        reading.refused.append(text[:80])
        return reading
    reading.said += _told(answer.structured_content or {})
    reading.part("answer", lambda: re.sub(r"[0-9.]+(e-?[0-9]+)?", "#", text.replace(str(folder), "")))
    return reading


def _told(answer: Any) -> Iterator[str]:
    """All warnings of an answer, at any depth."""
    if isinstance(answer, dict):
        for name, value in answer.items():
            yield from map(str, value) if name in TOLD and isinstance(value, list) else _told(value)
    elif isinstance(answer, list):
        for value in answer:
            yield from _told(value)


FILES: dict[str, Callable[[Path, Reading], None]] = {
    "policy.onnx": _policy_onnx, "policy.pt": _policy_pt, "model.onnx": _model_onnx, "scene.xml": _scene,
    "diagnosis.json": _diagnosis, "task.json": _task, "history.jsonl": _training,
    **{f"any.{kind}": _mesh for kind in ("ply", "obj", "stl", "glb", "off")},
}  # fmt: skip
READERS: dict[str, Callable[[Path], Reading]] = {
    "captures": read_capture,
    "cases": read_case,
    "recordings": read_recording,
    "others": read_other,
    "requests": read_request,
}
"""Kind, as in benchmarks.robustness.fuzz_sources -> its reader."""
