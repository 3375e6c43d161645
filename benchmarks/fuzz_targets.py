"""What is damaged by benchmarks/fuzz.py: a small sound example of everything that realsim reads, and its reader."""

from __future__ import annotations

import contextlib
import json
import math
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "feedforward")]

from realsim.errors import RealsimError
from realsim.files import digest


@dataclass
class Reading:
    """What came of reading something."""

    found: dict[str, str] = field(default_factory=dict)
    """Part -> digest of its value."""
    said: list[str] = field(default_factory=list)
    """Assumptions, warnings, frames that were dropped: everything that a user is told."""
    refused: list[str] = field(default_factory=list)
    shown: str = ""
    """The text for the terminal."""

    def part(self, name: str, read: Callable[[], Any]) -> Any:
        """The value of one part; an error that a user can act on is noted, any other one goes on."""
        try:
            value = read()
        except RealsimError as error:
            self.refused.append(f"{name}: {error.message}")
            self.shown += error.render() + "\n"
            return None
        self.found[name] = digest(repr(value) if not isinstance(value, np.ndarray) else value)
        return value


@dataclass(frozen=True)
class Target:
    """One kind of input."""

    trials: int
    sources: dict[str, Callable[[Path], None]]
    """Name -> writes a sound example into an empty folder."""
    read: Callable[[Path], Reading]


# ---------------------------------------------------------------- captures and scans


def captures() -> dict[str, Callable[[Path], None]]:
    from tests.capture.scene import walk
    from tests.capture.writers import WRITERS

    return {name: (lambda folder, write=write: write(folder, walk(6))) for name, write in WRITERS.items()}


def scans() -> dict[str, Callable[[Path], None]]:
    import trimesh

    def mesh() -> Any:
        floor = trimesh.creation.box((3, 2, 0.1)).subdivide()
        blocks = [trimesh.creation.box((0.5, 0.6, 0.3)).apply_translation([x, 0, 0.2]) for x in (-1, 1)]
        whole = trimesh.util.concatenate([floor, *blocks])
        colors = np.random.default_rng(0).integers(0, 256, (len(whole.vertices), 3), dtype=np.uint8)
        whole.visual = trimesh.visual.ColorVisuals(whole, vertex_colors=colors)
        return whole

    def cloud(folder: Path, how: str) -> None:
        from tests.capture.writers import write_pcd

        rng = np.random.default_rng(1)
        points = rng.uniform([0, 0, 0], [3, 2, 0.3], (500, 3)).astype(np.float32)
        colors = rng.integers(0, 256, (500, 3), dtype=np.uint8)
        if how == "ply":
            trimesh.PointCloud(points, colors=colors).export(folder / "cloud.ply")
        else:
            write_pcd(folder / "cloud.pcd", points[None], colors[None], data=how)

    def las(folder: Path) -> None:
        import laspy

        file = laspy.create(point_format=2, file_version="1.2")
        file.header.scales = [0.001] * 3
        file.xyz = np.random.default_rng(1).uniform([0, 0, 0], [3, 2, 0.3], (500, 3))
        file.write(folder / "room.las")

    made: dict[str, Callable[[Path], None]] = {
        f"scan {kind}": (lambda folder, kind=kind: mesh().export(folder / f"terrain.{kind}"))
        for kind in ("ply", "obj", "stl", "glb")
    }
    made["scan ply ascii"] = lambda folder: (
        (folder / "a.ply").write_bytes(mesh().export(file_type="ply", encoding="ascii")) and None
    )
    made |= {f"scan cloud {how}": (lambda folder, how=how: cloud(folder, how)) for how in ("ply", "binary", "ascii")}
    made["scan las"] = las
    return made


def read_capture(folder: Path) -> Reading:
    from realsim import capture
    from realsim.capture import CaptureConfig
    from realsim.types import Scan
    from tests.capture import fake_realsense

    sys.modules["pyrealsense2"] = fake_realsense  # type: ignore[assignment]
    reading = Reading()
    inspection = reading.part("inspection", lambda: _told(capture.inspect(folder, CaptureConfig()), folder))
    if inspection is not None:
        reading.shown += inspection.render()
        reading.said += [*inspection.assumptions, *inspection.wrong]
    data = reading.part("capture", lambda: _bare(capture.read(folder, CaptureConfig())))
    reading.found.clear()  # the digests of these two hold addresses
    if isinstance(data, Scan):
        reading.said += [*data.assumptions, *data.warnings]
        for name in ("points", "triangles", "normals", "colors"):
            reading.part(name, lambda name=name: _values(getattr(data, name)))
    elif data is not None:
        reading.said += [*data.assumptions, *data.warnings, *(f"{d.name}: {d.reason}" for d in data.dropped)]
        reading.part("number of frames", lambda: len(data))
        for i, frame in enumerate(data.frames):
            reading.part(f"name of frame {i}", lambda: frame.name)
            reading.part("time", lambda: frame.timestamp)
            for part in ("intrinsics", "color_intrinsics", "T_world_camera"):
                reading.part(f"{part} of frame {i}", lambda part=part: _values(getattr(frame, part)))
            reading.part(f"depth of frame {i}", lambda: frame.depth())
            reading.part(f"colour of frame {i}", lambda: frame.color())
            reading.part(f"confidence of frame {i}", lambda: frame.read_confidence and frame.read_confidence())
    return reading


def _told(inspection: Any, folder: Path) -> Any:
    return inspection


def _bare(data: Any) -> Any:
    return data


def _values(value: Any) -> Any:
    return value if value is None or not isinstance(value, np.ndarray) else value.tolist()


# ---------------------------------------------------------------- robots' logs


def cases() -> dict[str, Callable[[Path], None]]:
    from tests.gap.truth import ARM, PENDULUM, Truth, make_case

    options: dict[str, Any] = {"runs": 3, "seed": 3, "span": (1.5, 2.0)}

    def csv(folder: Path) -> None:
        from tests.gap.test_csv import MAP, write

        make_case(folder, ARM, Truth(), torque="measured", **options)
        for path in sorted((folder / "runs").glob("*.npz")):
            with np.load(path) as data:
                d = dict(data)
            table = {"stamp": 1e6 * (d["time"] + 1.7e9)}
            for name, values in (("des", d["command"]), ("pos", d["joint_pos"]), ("vel", d["joint_vel"])):
                table |= {f"{j}_{name}": np.degrees(values[:, k]) for k, j in enumerate("se")}
            write(path.with_suffix(".csv"), table)
            path.unlink()
        (folder / "columns.json").write_text(
            json.dumps(
                MAP
                | {
                    "joint_pos": {"columns": ["s_pos", "e_pos"], "unit": "deg"},
                    "joint_vel": {"columns": ["s_vel", "e_vel"], "unit": "deg/s"},
                }
            )
        )

    def setups(folder: Path) -> None:
        make_case(folder, ARM, Truth(), imu="wrist", torque="measured", **options)
        log = json.loads((folder / "log.json").read_text())
        log["runs"] = {
            "run_01": {
                "payload": [{"body": "fore", "mass": 0.5, "at": [0, 0, -0.3]}],
                "gains": {"elbow_servo": {"kp": 40}},
            }
        }
        log["units"] = {"joint_pos": "rad", "time": "s"}
        (folder / "log.json").write_text(json.dumps(log))

    return {
        "case pendulum": lambda folder: make_case(folder, PENDULUM, Truth(), **options) and None,
        "case arm": lambda folder: make_case(folder, ARM, Truth(), **options) and None,
        "case csv": csv,
        "case setups": setups,
    }


def read_case(folder: Path) -> Reading:
    from realsim.gap.config import DiagnoseConfig
    from realsim.gap.health import examine
    from realsim.gap.logs.case import load_case
    from realsim.gap.pipeline import limited
    from realsim.gap.simulation.simulate import Simulator

    reading, config = Reading(), DiagnoseConfig()
    case = reading.part("case", lambda: load_case(folder))
    reading.found.clear()
    if case is None:
        return reading
    reading.said += [*case.warnings, *case.dropped_runs]
    for name in ("joint_names", "actuator_names", "command_kind", "base", "torque_kind", "imu_site", "contact_bodies"):
        reading.part(name, lambda name=name: getattr(case, name))
    reading.part("model", lambda: _model_numbers(case.model))
    for run in case.runs:
        reading.part(f"{run.name} time", lambda: run.time)
        reading.part(f"{run.name} command", lambda: run.command)
        reading.part(f"{run.name} setup", lambda: run.setup)
        for name, values in run.signals.items():
            reading.part(f"{run.name} {name}", lambda values=values: values)

    def health() -> Any:
        with Simulator(limited(case, config), config) as simulator:
            return examine(simulator)

    found = reading.part("health", health)
    reading.found.pop("health", None)
    if found is not None:
        reading.said += [str(w) for w in found.get("warnings", [])]
        reading.shown += json.dumps(found, default=str, ensure_ascii=True)
    return reading


def _model_numbers(model: Any) -> list[Any]:
    names = ("body_mass", "body_inertia", "body_pos", "jnt_range", "dof_damping", "actuator_gainprm", "geom_size")
    return [model.opt.timestep, *(np.asarray(getattr(model, n)).tolist() for n in names)]


def recordings() -> dict[str, Callable[[Path], None]]:
    from tests.logs import test_formats, writers
    from tests.logs.robots import ARM, QUADRUPED, drive, save

    def of(write: Callable[[Path, Any], Any]) -> Callable[[Path], None]:
        def make(folder: Path) -> None:
            (folder / "log").mkdir()
            save(folder, ARM)
            write(folder / "log", drive(ARM, seconds=2.0))

        return make

    def unitree(folder: Path) -> None:
        (folder / "log").mkdir()
        save(folder, QUADRUPED)
        writers.unitree(folder / "log" / "run", drive(QUADRUPED, seconds=1.0), test_formats.SDK)

    made = {name[3:]: getattr(test_formats, name) for name in dir(test_formats) if name.startswith("as_")}
    return {f"log {name}": of(write) for name, write in made.items()} | {"log unitree": unitree}


def read_recording(folder: Path) -> Reading:
    from realsim import logs

    reading = Reading()
    target = reading.part("target", lambda: logs.load_target(folder / "robot.xml"))
    inside = sorted((folder / "log").iterdir()) if (folder / "log").is_dir() else []
    path = inside[0] if len(inside) == 1 else folder / "log"
    found = reading.part("recordings", lambda: logs.read(path))
    reading.found.clear()
    if found is None:
        return reading
    for recording in found:
        reading.said += [*recording.notes, *(f"{k}: {v}" for k, v in recording.skipped.items())]
        for stream in recording.streams:
            for name, item in stream.fields.items():
                reading.part(f"{stream.name} {name}", lambda item=item: item.values)
            for name, clock in stream.clocks.items():
                reading.part(f"{stream.name} {name} clock", lambda clock=clock: clock)
    proposal = reading.part("proposal", lambda: logs.propose(found, target))
    reading.found.pop("proposal", None)
    if proposal is not None:
        reading.shown += proposal.render()
        reading.said += [
            *proposal.missing,
            *proposal.warnings,
            *proposal.clocks,
            *(e for a in proposal.assignments.values() for e in a.evidence),
        ]
        if proposal.complete and target is not None:
            out = folder.parent / "written"
            shutil.rmtree(out, ignore_errors=True)
            notes = reading.part("written", lambda: logs.write_case(proposal, target, out))
            reading.found.pop("written", None)
            reading.said += notes or []
            if notes is not None:
                reading.part("read again", lambda: len(__import__("realsim.gap", fromlist=["gap"]).load_case(out).runs))
    return reading


# ---------------------------------------------------------------- policies, models, scenes


def policies() -> dict[str, Callable[[Path], None]]:
    def onnx(folder: Path) -> None:
        from trainer.policies import FOLDER

        shutil.copy(FOLDER / "g1_parkour.onnx", folder / "policy.onnx")

    def metadata(folder: Path) -> None:
        """The metadata as a file of their own, so that they are damaged as JSON is; put back before they are read."""
        import onnx as library

        onnx(folder)
        model = library.load(folder / "policy.onnx")
        (folder / "metadata.json").write_text(next(p.value for p in model.metadata_props if p.key == "realsim"))

    def checkpoint(folder: Path) -> None:
        import torch

        from tests.trainer.toy import LAYOUT
        from trainer.ppo import checkpoint, policy
        from trainer.ppo.config import NetworkConfig

        torch.manual_seed(0)
        checkpoint.save(folder / "policy.pt", policy.new(LAYOUT, NetworkConfig(), "quadruped", 0))

    def contents(folder: Path) -> None:
        checkpoint(folder)
        import torch

        data = torch.load(folder / "policy.pt", weights_only=True)
        plain = {k: data[k] for k in ("format", "version", "robot", "layout", "networks", "tuned")}
        (folder / "contents.json").write_text(json.dumps(plain))

    def pointmap(folder: Path) -> None:
        import rooms
        from analytic import answers, room_frame

        from benchmarks.simulated_model import Shape, write_model

        frames = [room_frame(k, T) for k, T in enumerate(rooms.path(2, 0.15))]
        write_model(folder / "model.onnx", answers(frames, rooms.path(2, 0.15), Shape()), Shape())

    def silent_pointmap(folder: Path) -> None:
        import rooms
        from analytic import answers, room_frame

        from benchmarks.simulated_model import Shape, write_model

        frames, shape = [room_frame(k, T) for k, T in enumerate(rooms.path(2, 0.15))], Shape(said=False)
        write_model(folder / "model.onnx", answers(frames, rooms.path(2, 0.15), shape), shape)
        said = {"kind": shape.kind, "norm": shape.norm, "patch": 14, "fit": shape.fit, "pose": "c2w", "conf": "logit"}
        (folder / "model.json").write_text(json.dumps(said))

    def scene(folder: Path) -> None:
        import trimesh

        import realsim as rs

        floor = trimesh.creation.box((4, 2, 0.1)).apply_translation([1, 0, -0.35])
        tops = [trimesh.creation.box((0.8, 0.8, 0.3)).apply_translation([x, 0, -0.15]) for x in (0, 2)]
        whole = trimesh.util.concatenate([floor.subdivide(), *(t.subdivide() for t in tops)])
        whole.export(folder.parent / "terrain.ply")
        from realsim.align.config import AlignConfig
        from realsim.exports.config import SceneConfig
        from realsim.pipeline import ReconstructConfig

        config = ReconstructConfig(
            align=AlignConfig(start=(0.0, 0.0), goal=(2.0, 0.0)), scene=SceneConfig(contact="boxes", contact_probes=200)
        )
        made = rs.reconstruct(folder.parent / "terrain.ply", folder.parent / "made", config, overwrite=True)
        shutil.copytree(made.folder, folder, dirs_exist_ok=True)

    def any_mesh(kind: str) -> Callable[[Path], None]:
        def make(folder: Path) -> None:
            import trimesh

            parts = [
                trimesh.creation.box((2, 2, 0.1)),
                trimesh.creation.box((0.4, 0.4, 0.3)).apply_translation([0, 0, 0.2]),
            ]
            trimesh.util.concatenate(parts).export(folder / f"any.{kind}")

        return make

    def diagnosis(folder: Path) -> None:
        """The form of diagnosis.json; its numbers are of no robot."""
        interval = {"value": 0.01, "ci90": [0.005, 0.02], "unit": "s"}
        cause = {
            "effect": "command_delay",
            "joints": [],
            "bodies": [],
            "parameters": {"delay": interval},
            "probability": 0.8,
        }
        scales = dict.fromkeys(
            ("peak_torque", "speed", "mean_torque", "mean_speed", "torque_range", "inertia"), {"swing": 1.0}
        )
        setting = {"effect": "viscous_friction", "place": ["swing"], "coordinates": {"added": 0.1}}
        patch = {"format": "realsim.gap.patch/2", "command_kind": "position", "settings": [setting], "scales": scales}
        data = {
            "verdict": "identified", "sentence": "a", "causes": [cause], "equivalent": [[cause]],
            "where": [{"signal": "joint_pos", "joint": "swing", "phase": None, "share": 0.5}],
            "shrinkage": {"fraction": 0.9, "ci90": [0.8, 0.95], "runs": ["run_01"], "unseen": True},
            "unexplained_share": 0.1, "patch": patch, "health": {"warnings": []},
        }  # fmt: skip
        (folder / "diagnosis.json").write_text(json.dumps(data))

    found: dict[str, Callable[[Path], None]] = {
        "policy onnx": onnx, "policy onnx metadata": metadata, "policy pt": checkpoint, "policy pt contents": contents,
        "model onnx": pointmap, "model onnx sidecar": silent_pointmap, "scene": scene, "scene again": scene,
        "diagnosis": diagnosis,
    }  # fmt: skip
    return found | {f"mesh {kind}": any_mesh(kind) for kind in ("ply", "obj", "stl", "glb", "off")}


def read_policy(folder: Path) -> Reading:
    names = {p.name for p in folder.iterdir()}
    reading = Reading()
    if "metadata.json" in names or "contents.json" in names:
        _put_back(folder)
    for kind, read in READERS.items():
        if kind in names:
            read(folder / kind, reading)
    if not set(READERS) & names:  # the file itself is gone or renamed: the reader is asked for what is not there
        READERS["policy.onnx"](folder / "policy.onnx", reading)
    return reading


def _put_back(folder: Path) -> None:
    """Damaged metadata into the file that they belong to; what cannot be put there is left out."""
    with contextlib.suppress(Exception):  # onnx and torch raise what they like; the damage then is all there is
        if (folder / "metadata.json").is_file():
            import onnx as library

            model = library.load(folder / "policy.onnx")
            next(p for p in model.metadata_props if p.key == "realsim").value = (folder / "metadata.json").read_text()
            library.save(model, folder / "policy.onnx")
        else:
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
    from trainer.deploy.loop import DeployConfig, deploy
    from trainer.ppo import export

    loaded = reading.part("policy", lambda: export.load(path))
    reading.found.pop("policy", None)
    if loaded is None:
        return
    session, facts = loaded
    reading.part("facts", lambda: facts)
    robot = _Robot(facts.layout.depth)
    config = DeployConfig(seconds=3.5 * facts.policy_dt, realtime=False)
    reading.part(
        "loop", lambda: deploy(robot, session, facts, config, steer=lambda speed: np.array([speed, 0, 0])).steps
    )


def _policy_pt(path: Path, reading: Reading) -> None:
    import torch

    from trainer.ppo import checkpoint

    loaded = reading.part("policy", lambda: checkpoint.load(path))
    reading.found.pop("policy", None)
    if loaded is None:
        return
    policy = loaded[0]
    reading.part("layout", lambda: (policy.layout, policy.robot, policy.networks, policy.tuned))
    layout = policy.layout
    with torch.no_grad():
        depth = None if layout.depth is None else torch.zeros(1, *layout.depth)
        reading.part("action", lambda: policy.actor(torch.zeros(1, layout.actor_width), depth).numpy().round(4))


def _model_onnx(path: Path, reading: Reading) -> None:
    from realsim.feedforward.onnx.inspect import inspect_model

    found = reading.part("model", lambda: inspect_model(path))
    if found is not None:
        text = found.render().replace(str(path), "")
        reading.shown += text
        reading.said += [text]


def _scene(path: Path, reading: Reading) -> None:
    import realsim as rs
    from trainer.errors import TrainerError
    from trainer.terrain.scene import load

    folder = path.parent
    scene = reading.part("scene", lambda: rs.load_scene(folder))
    reading.found.pop("scene", None)
    if scene is not None:
        reading.part("figures", lambda: (scene.contact, scene.verdict, scene.start, scene.goal, scene.warnings))
        reading.part("page", lambda: len(scene._repr_html_()))
        reading.shown += repr(scene)
    out = folder.parent / "exported"
    shutil.rmtree(out, ignore_errors=True)
    for name in ("mjcf", "urdf", "obj", "heightmap", "terrain", "glb"):
        files = reading.part(f"export {name}", lambda name=name: rs.export(folder, name, out)[name])
        if files is not None:
            reading.part(f"exported {name}", lambda files=files: [digest(f) for f in files])
    terrain = reading.part("terrain", lambda: load(folder))
    reading.found.pop("terrain", None)
    if terrain is not None:
        reading.part("course", lambda: (terrain.start, terrain.goal, terrain.floor_z, terrain.vertices.shape))
    assert issubclass(TrainerError, RealsimError)


def _mesh(path: Path, reading: Reading) -> None:
    from realsim.exports.ground import ground_level
    from realsim.exports.mend import read_mesh

    made = reading.part("mesh", lambda: read_mesh(path))
    reading.found.pop("mesh", None)
    if made is not None:
        mesh, notes = made
        reading.said += notes
        reading.part("vertices", lambda: mesh.vertices)
        reading.part("triangles", lambda: mesh.triangles)
        reading.part("ground", lambda: math.floor(1e6 * ground_level(mesh).z))


def _diagnosis(path: Path, reading: Reading) -> None:
    import mujoco

    import realsim as rs
    from tests.gap.truth import PENDULUM
    from trainer.robots import ROBOTS
    from trainer.tasks.parkour import gap

    found = reading.part("diagnosis", lambda: rs.load_diagnosis(path.parent))
    if found is not None:
        reading.part("page", lambda: found._repr_html_())
        reading.shown += repr(found)
        reading.part("trainer", lambda: gap.load(path, ROBOTS["quadruped"]()))
        reading.part("patched", lambda: rs.apply_patch(mujoco.MjSpec.from_string(PENDULUM), found))


READERS: dict[str, Callable[[Path, Reading], None]] = {
    "policy.onnx": _policy_onnx, "policy.pt": _policy_pt, "model.onnx": _model_onnx, "scene.xml": _scene,
    "diagnosis.json": _diagnosis, **{f"any.{kind}": _mesh for kind in ("ply", "obj", "stl", "glb", "off")},
}  # fmt: skip
TARGETS: dict[str, tuple[int, Callable[[], dict[str, Callable[[Path], None]]], Callable[[Path], Reading]]] = {
    "captures": (1000, lambda: captures() | scans(), read_capture),
    "cases": (500, cases, read_case),
    "recordings": (300, recordings, read_recording),
    "policies": (200, policies, read_policy),
}
