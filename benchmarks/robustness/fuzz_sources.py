"""Small sound examples of everything that realsim reads, for benchmarks/robustness/fuzz.py to damage."""

import json
import shutil
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[k]) + end for k, end in ((2, ""), (2, "/tests/feedforward"))]

Write = Callable[[Path], Any]
"""Writes an example into an empty folder."""


def captures() -> dict[str, Write]:
    from tests.capture.scene import walk
    from tests.capture.writers import WRITERS

    return {name: partial(_walk, write, walk(6)) for name, write in WRITERS.items()}


def _walk(write: Callable[[Path, Any], None], views: Any, folder: Path) -> None:
    write(folder, views)


def scans() -> dict[str, Write]:
    import trimesh

    def mesh() -> Any:
        floor = trimesh.creation.box((3, 2, 0.1)).subdivide()
        blocks = [trimesh.creation.box((0.5, 0.6, 0.3)).apply_translation([x, 0, 0.2]) for x in (-1, 1)]
        whole = trimesh.util.concatenate([floor, *blocks])
        colors = np.random.default_rng(0).integers(0, 256, (len(whole.vertices), 3), dtype=np.uint8)
        whole.visual = trimesh.visual.ColorVisuals(whole, vertex_colors=colors)
        return whole

    def mesh_as(kind: str, folder: Path) -> None:
        mesh().export(folder / f"terrain.{kind}")

    def ply_as_text(folder: Path) -> None:
        (folder / "a.ply").write_bytes(mesh().export(file_type="ply", encoding="ascii"))

    def cloud(how: str, folder: Path) -> None:
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

    made: dict[str, Write] = {f"scan {kind}": partial(mesh_as, kind) for kind in ("ply", "obj", "stl", "glb")}
    made |= {f"scan cloud {how}": partial(cloud, how) for how in ("ply", "binary", "ascii")}
    return made | {"scan ply ascii": ply_as_text, "scan las": las}


def cases() -> dict[str, Write]:
    from tests.gap.test_csv import MAP, write
    from tests.gap.truth import ARM, PENDULUM, Truth, make_case

    options: dict[str, Any] = {"runs": 3, "seed": 3, "span": (1.5, 2.0)}

    def csv(folder: Path) -> None:
        make_case(folder, ARM, Truth(), torque="measured", **options)
        for path in sorted((folder / "runs").glob("*.npz")):
            with np.load(path) as data:
                kinds = {"des": data["command"], "pos": data["joint_pos"], "vel": data["joint_vel"]}
                table = {"stamp": 1e6 * (data["time"] + 1.7e9)}
            table |= {f"{j}_{n}": np.degrees(v[:, k]) for n, v in kinds.items() for k, j in enumerate("se")}
            write(path.with_suffix(".csv"), table)
            path.unlink()
        place, speed = ({"columns": [f"s_{n}", f"e_{n}"], "unit": u} for n, u in (("pos", "deg"), ("vel", "deg/s")))
        (folder / "columns.json").write_text(json.dumps(MAP | {"joint_pos": place, "joint_vel": speed}))

    def setups(folder: Path) -> None:
        make_case(folder, ARM, Truth(), imu="wrist", torque="measured", **options)
        log = json.loads((folder / "log.json").read_text())
        load = {"body": "fore", "mass": 0.5, "at": [0, 0, -0.3]}
        log["runs"] = {"run_01": {"payload": [load], "gains": {"elbow_servo": {"kp": 40}}}}
        log["units"] = {"joint_pos": "rad", "time": "s"}
        (folder / "log.json").write_text(json.dumps(log))

    return {
        "case pendulum": lambda folder: make_case(folder, PENDULUM, Truth(), **options),
        "case arm": lambda folder: make_case(folder, ARM, Truth(), **options),
        "case csv": csv,
        "case setups": setups,
    }


def recordings() -> dict[str, Write]:
    from tests.gap.recordings import test_formats, writers
    from tests.gap.recordings.robots import ARM, QUADRUPED, drive, save

    def of(write: Callable[[Path, Any], Any], folder: Path) -> None:
        (folder / "log").mkdir()
        save(folder, ARM)
        write(folder / "log", drive(ARM, seconds=2.0))

    def unitree(folder: Path) -> None:
        (folder / "log").mkdir()
        save(folder, QUADRUPED)
        writers.unitree(folder / "log" / "run", drive(QUADRUPED, seconds=1.0), test_formats.SDK)

    made = {name[3:]: getattr(test_formats, name) for name in dir(test_formats) if name.startswith("as_")}
    return {f"log {name}": partial(of, write) for name, write in made.items()} | {"log unitree": unitree}


# ---------------------------------------------------------------- policies, models, scenes, results


def others() -> dict[str, Write]:
    meshes: dict[str, Write] = {f"mesh {k}": partial(_any_mesh, k) for k in ("ply", "obj", "stl", "glb", "off")}
    return meshes | {
        "policy onnx": _policy_onnx, "policy onnx metadata": _metadata, "policy pt": _checkpoint,
        "policy pt contents": _contents, "model onnx": partial(_pointmap, True),
        "model onnx sidecar": partial(_pointmap, False), "scene": _scene, "diagnosis": _diagnosis, "task": _task,
        "training": _training,
    }  # fmt: skip


def _policy_onnx(folder: Path) -> None:
    from trainer.policies import FOLDER

    shutil.copy(FOLDER / "g1_parkour.onnx", folder / "policy.onnx")


def _metadata(folder: Path) -> None:
    """The metadata as a file of their own, so that they are damaged as JSON is; put back before they are read."""
    import onnx

    _policy_onnx(folder)
    model = onnx.load(folder / "policy.onnx")
    (folder / "metadata.json").write_text(next(p.value for p in model.metadata_props if p.key == "realsim"))


def _checkpoint(folder: Path) -> None:
    import torch

    from tests.trainer.toy import LAYOUT
    from trainer.ppo import checkpoint, policy
    from trainer.ppo.config import NetworkConfig

    torch.manual_seed(0)
    checkpoint.save(folder / "policy.pt", policy.new(LAYOUT, NetworkConfig(), "quadruped", 0))


def _contents(folder: Path) -> None:
    import torch

    _checkpoint(folder)
    data = torch.load(folder / "policy.pt", weights_only=True)
    plain = {k: data[k] for k in ("format", "version", "robot", "layout", "networks", "tuned")}
    (folder / "contents.json").write_text(json.dumps(plain))


def _pointmap(said: bool, folder: Path) -> None:
    """A model that says in itself what it is, or in a file beside it."""
    import rooms
    from analytic import answers, room_frame

    from tests.truths.simulated_model import Shape, write_model

    shape, path = Shape(said=said), rooms.path(2, 0.15)
    write_model(folder / "model.onnx", answers([room_frame(k, T) for k, T in enumerate(path)], path, shape), shape)
    if not said:
        beside = {"kind": shape.kind, "norm": shape.norm, "patch": 14, "fit": shape.fit, "pose": "c2w", "conf": "logit"}
        (folder / "model.json").write_text(json.dumps(beside))


def _scene(folder: Path) -> None:
    import realsim as rs
    from realsim.align.config import AlignConfig
    from realsim.export.config import SceneConfig
    from realsim.pipeline import ReconstructConfig

    boxes = [((4, 2, 0.1), (1, 0, -0.35)), ((0.8, 0.8, 0.3), (0, 0, -0.15)), ((0.8, 0.8, 0.3), (2, 0, -0.15))]
    scan = folder.parent / "terrain.ply"
    _boxes(boxes).export(scan)
    scene = SceneConfig(contact="boxes", contact_probes=200)
    config = ReconstructConfig(align=AlignConfig(start=(0.0, 0.0), goal=(2.0, 0.0)), scene=scene)
    made = rs.reconstruct(scan, folder.parent / "made", config, overwrite=True)
    shutil.copytree(made.folder, folder, dirs_exist_ok=True)


def _any_mesh(kind: str, folder: Path) -> None:
    _boxes([((2, 2, 0.1), (0, 0, 0)), ((0.4, 0.4, 0.3), (0, 0, 0.2))]).export(folder / f"any.{kind}")


def _boxes(sizes: list[tuple[tuple[float, ...], tuple[float, ...]]]) -> Any:
    import trimesh

    return trimesh.util.concatenate([trimesh.creation.box(s).subdivide().apply_translation(at) for s, at in sizes])


def _diagnosis(folder: Path) -> None:
    """The form of diagnosis.json; its numbers are of no robot."""
    interval = {"value": 0.01, "ci90": [0.005, 0.02], "unit": "s"}
    cause = {"effect": "command_delay", "joints": [], "bodies": [], "parameters": {"delay": interval}}
    scales = ("peak_torque", "speed", "mean_torque", "mean_speed", "torque_range", "inertia")
    setting = {"effect": "viscous_friction", "place": ["swing"], "coordinates": {"added": 0.1}}
    patch = {"format": "realsim.gap.patch/2", "command_kind": "position", "settings": [setting]}
    data = {
        "verdict": "identified", "sentence": "a", "causes": [cause], "equivalent": [[cause]],
        "where": [{"signal": "joint_pos", "joint": "swing", "phase": None, "share": 0.5}],
        "shrinkage": {"fraction": 0.9, "ci90": [0.8, 0.95], "runs": ["run_01"], "unseen": True},
        "unexplained_share": 0.1, "patch": patch | {"scales": {name: {"swing": 1.0} for name in scales}},
        "health": {"warnings": []},
    }  # fmt: skip
    (folder / "diagnosis.json").write_text(json.dumps(data))


def _task(folder: Path) -> None:
    task = {"command": {"speed": [0.5, 0.8]}, "depth": {"use": False, "noise": 0.01}, "reset": {"yaw": 0.1}}
    (folder / "task.json").write_text(json.dumps(task))


def _training(folder: Path) -> None:
    from tests.trainer.histories import row

    (folder / "history.jsonl").write_text("".join(json.dumps(row(i)) + "\n" for i in range(60)))


# ---------------------------------------------------------------- requests of agents


def requests() -> dict[str, Write]:
    """`request.json` as an agent sends it, beside the files that it names."""
    calls: dict[str, dict[str, Any]] = {
        "inspect": {"frames": "any.stl"},
        "contact": {"meshes": "any.stl", "out": "made", "unit": "m", "ground_z": -0.05, "overwrite": True},
        "export": {"scenes": "scene", "to": "obj,stl", "out": "made"},
        "diagnose": {"cases": "case", "check": True, "max_causes": 1},
        "report": {"folder": "scene"},
    }
    return {f"request {tool}": partial(_request, tool, arguments) for tool, arguments in calls.items()}


def _request(tool: str, arguments: dict[str, Any], folder: Path) -> None:
    _any_mesh("stl", folder)
    if tool in ("export", "report"):
        _scene(folder / "scene")
    if tool == "diagnose":
        from tests.gap.truth import ARM, Truth, make_case

        make_case(folder / "case", ARM, Truth(), runs=2, seed=1, span=(1.0, 1.2))
    (folder / "request.json").write_text(json.dumps({"tool": tool, "arguments": arguments}))


TARGETS: dict[str, tuple[int, Callable[[], dict[str, Write]]]] = {
    "captures": (1000, lambda: captures() | scans()),
    "cases": (500, cases),
    "recordings": (300, recordings),
    "others": (200, others),
    "requests": (100, requests),
}
"""Kind -> (trials, its examples)."""
