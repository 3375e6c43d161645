"""Measure a network: on generated scenes that it was not trained on, and on captures with exact truth.

    python -m training.pointmap.evaluate --state run                          generated scenes
    python -m training.pointmap.evaluate --model pointmap.onnx \\
        --captures ../shared/captures/stake_a ../shared/captures/narrow_a     captures with truth, by onnxruntime
    python -m training.pointmap.evaluate --model pointmap.onnx --real FOLDER  captures without: against their sensor

Every figure is printed beside the bar that it has to meet, and beside what a prediction that knows nothing gets. With
`--json FILE` the rows are stored too. Captures are never trained on.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from realsim.core.errors import CaptureError, RealsimError
from training.pointmap import shipped
from training.pointmap.layouts import LAYOUTS, library
from training.pointmap.metrics import Figures, figures
from training.pointmap.network import PointmapNet
from training.pointmap.scenes import Batch, Generator
from training.pointmap.train import WITHHELD

Row = dict[str, Any]
BARS = {"rgbd": {"abs_rel": 0.02, "rotation_deg": 3.0}, "rgb": {"abs_rel": 0.08, "rotation_deg": 8.0}}
"""At most, by what the network is given (colour always, depth or none)."""
BAR_SECONDS = 25.0
"""For 60 frames on two cores."""
VIEWS = 8
"""Of a window."""
STEPS = (1, 4)
"""Frames from one view of a window to the next: neighbours, and views that share less. Between neighbours the camera
hardly turns: a network that says that nothing moved meets the bar of the rotation there, so the second one counts."""


# ---------------------------------------------------------------- generated scenes


def generated(
    net: PointmapNet, size: tuple[int, int], scenes: int = 64, views: int = 4, device: str = "cpu", seed: int = WITHHELD
) -> Iterator[Row]:
    """Rows by kind of scene and input, over withheld layouts, cameras and materials; `all` holds every kind.

    Args:
        scenes: of every kind.
    """
    net = net.to(device).eval()
    found: dict[str, list[Figures]] = {}
    for k, kind in enumerate(LAYOUTS):
        made = Generator(library(scenes, seed + k, (kind,)), seed + k, device, samples=1)
        for at in range(0, scenes, 8):
            whole = made.render(at, min(8, scenes - at), views, size)
            batch = _seeing(made, made.observe(whole, at), at)
            for given in BARS:
                rows = _figures(net, batch.with_inputs(depth=given == "rgbd"))
                for group in (kind, "all"):
                    found.setdefault(f"{given} {group}", []).extend(rows)
    for name, values in sorted(found.items()):
        given, group = name.split(" ")
        yield {"data": "generated", "given": given, "scenes": group, "count": len(values), **_medians(values)}


def _seeing(made: Generator, batch: Batch, index: int) -> Batch:
    """The batch with sensor depth in every view."""
    from training.pointmap import sensor
    from training.pointmap.draw import Draw

    measured = sensor.depth(Draw.of(made.seed + 7, index, made.device), batch.depth, batch.K[:, 0, 0, 0])
    return Batch(batch.images, measured, batch.depth, batch.K, batch.T)


@torch.no_grad()
def _figures(net: PointmapNet, batch: Batch) -> list[Figures]:
    device = batch.depth.device
    with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
        out = net(batch.images, batch.sensor, batch.K)
    T = batch.T.clone()
    T[..., :3, :3], T[..., :3, 3] = out.R, out.t
    depth, conf = out.log_z.exp().cpu().numpy(), torch.sigmoid(-out.log_error).cpu().numpy()
    truth = torch.where(batch.depth < 20, batch.depth, 0.0).cpu().numpy()
    poses, true_poses = T.double().cpu().numpy(), batch.T.double().cpu().numpy()
    return [figures(depth[i], conf[i], poses[i], truth[i], true_poses[i]) for i in range(len(depth))]


def _medians(values: Sequence[Figures]) -> Row:
    """Means of errors of depth, medians of angles (each a median over pairs already)."""
    out: Row = {}
    for name in ("abs_rel", "abs_rel_view", "flat", "area", "area_oracle", "confidence"):
        known = [x for x in (getattr(v, name) for v in values) if np.isfinite(x)]
        out[name] = float(np.mean(known)) if known else float("nan")
    for name in ("rotation_deg", "still_deg", "direction_deg"):
        known = [x for x in (getattr(v, name) for v in values) if np.isfinite(x)]
        out[name] = float(np.median(known)) if known else float("nan")
    return {**out, "ause": out["area"] - out["area_oracle"]}


# ---------------------------------------------------------------- captures


@dataclass(frozen=True)
class Truth:
    """Frames of a capture with exact poses, and the surface that its truth holds."""

    name: str
    frames: tuple[Any, ...]
    T_mesh_camera: np.ndarray
    """(N, 4, 4)."""
    mesh: Any
    """open3d's RaycastingScene; None where the sensor's own depth has to serve for the truth."""


def read(folder: Path) -> Truth:
    """A capture with `capture/` and `gt/` (gt_mesh.ply, gt.json, gt_poses.json) below `folder`.

    Raises:
        CaptureError: a part is missing, or a frame has no true pose.
    """
    import open3d as o3d

    from realsim import capture
    from realsim.capture.config import CaptureConfig
    from realsim.core.files import read_json

    for part in ("capture", "gt/gt_mesh.ply", "gt/gt.json"):
        if not (folder / part).exists():
            raise CaptureError("not a capture with truth", file=folder, expected=part, found="nothing of that name")
    frames = capture.read(folder / "capture", CaptureConfig(max_frames=0, keep_blurred=True))
    told = np.asarray(read_json(folder / "gt" / "gt.json")["T_sim_from_world"], float)
    kept = tuple(f for f in getattr(frames, "frames", ()) if f.T_world_camera is not None)
    if not kept:
        raise CaptureError("the capture has no poses", file=folder, expected="poses of its frames")
    mesh = o3d.io.read_triangle_mesh(folder / "gt" / "gt_mesh.ply")
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    return Truth(folder.name, kept, np.stack([told @ f.T_world_camera for f in kept]), scene)


def read_real(folder: Path) -> Truth:
    """A capture without truth: its sensor's depth and, if it has them, its poses stand in.

    Raises:
        CaptureError: not a capture of frames.
    """
    from realsim import capture
    from realsim.capture.config import CaptureConfig

    frames = getattr(capture.read(folder, CaptureConfig(max_frames=60)), "frames", ())
    kept = tuple(f for f in frames if f.read_color is not None)
    if not kept:
        raise CaptureError("not a capture of colour frames", file=folder, expected="frames with colour and depth")
    unknown = np.full((4, 4), np.nan)
    return Truth(
        "/".join(folder.resolve().parts[-2:]),
        kept,
        np.stack([unknown if f.T_world_camera is None else f.T_world_camera for f in kept]),
        None,
    )


def true_depth(truth: Truth, i: int, grid: Any) -> np.ndarray:
    """(H, W) depth of the true surface on the model's grid, 0 where it has none or something else is in front.

    Walls and clutter are in the pictures but not in the truth: pixels where the sensor sees something nearer by more
    than 5 % are left out.
    """
    from realsim.feedforward.onnx.preprocess import depth_to_grid

    frame, T = truth.frames[i], truth.T_mesh_camera[i]
    seen = depth_to_grid(frame.depth(), frame.intrinsics, grid)
    if truth.mesh is None:
        return seen
    d = grid.camera.rays().astype(np.float64)
    rays = np.concatenate([np.broadcast_to(T[:3, 3], d.shape), d @ T[:3, :3].T], -1)
    z = truth.mesh.cast_rays(rays.astype(np.float32))["t_hit"].numpy()
    hidden = (seen > 0) & (seen < 0.95 * z)
    return np.where(np.isfinite(z) & ~hidden, z, 0.0).astype(np.float32)


def captured(model_file: Path, truth: Truth, views: int = VIEWS) -> Iterator[Row]:
    """Rows of a capture: all its windows of `views` frames, with and without depth, for each of STEPS."""
    from realsim.feedforward.onnx.session import open_model

    model = open_model(model_file)
    for given in BARS if truth.mesh is not None else ("rgb",):
        for step in STEPS:
            windows = [w for w in _windows(len(truth.frames), views, step) if len(w) > 1]
            values = [_window(model, truth, w, given) for w in windows]
            yield {"data": truth.name, "given": given, "step": step, "count": len(values), **_medians(values)}


def _windows(count: int, views: int, step: int) -> list[range]:
    """Every frame is in one window, frames of a window lie `step` apart; the last ones are shorter."""
    long = views * step
    return [range(at + k, min(at + long, count), step) for at in range(0, count, long) for k in range(step)]


def _window(model: Any, truth: Truth, which: Sequence[int], given: str) -> Figures:
    found, inputs = _predict(model, [truth.frames[i] for i in which], given)
    true = np.stack([true_depth(truth, i, g) for i, g in zip(which, inputs.grids, strict=True)])
    return figures(found.local_points[..., 2], found.conf, found.T_world_camera, true, truth.T_mesh_camera[list(which)])


def _predict(model: Any, frames: Sequence[Any], given: str) -> tuple[Any, Any]:
    """What the model says of a window, before anything is refused or left out."""
    from realsim.feedforward.onnx.adapters import ADAPTERS
    from realsim.feedforward.onnx.inputs import Inputs

    inputs = Inputs.of(frames, model.spec, with_depth=given == "rgbd")
    index = range(len(frames))
    out = model.run(inputs.feeds(index))
    return ADAPTERS[model.spec.kind].unpack(out, inputs.call(index, len(frames))), inputs


SPOILT = ("as it is", "night", "overexposed", "blurred", "wide crop")
"""What is done to one view of a window."""


def doubts(model_file: Path, truth: Truth, views: int = 4, windows: int = 5) -> Iterator[Row]:
    """Confidence and error of a view without depth when it alone is dark, burnt out, blurred or cut to 3:1: the
    confidence has to fall as the error rises."""
    from realsim.feedforward.onnx.session import open_model

    model = open_model(model_file)
    starts = np.linspace(0, len(truth.frames) - views, windows).astype(int)
    for how in SPOILT:
        confs, errors = [], []
        for at in starts:
            frames = [*truth.frames[at : at + views]]
            frames[1] = spoilt(frames[1], how)
            found, inputs = _predict(model, frames, "rgb")
            rest = Truth(truth.name, tuple(frames), truth.T_mesh_camera[at : at + views], truth.mesh)
            true = np.stack([true_depth(rest, k, g) for k, g in enumerate(inputs.grids)])
            z = found.local_points[..., 2]
            known = true > 0
            scale = np.median(true[known] / z[known])
            errors.append(float(np.abs(scale * z[1] / np.maximum(true[1], 1e-6) - 1)[known[1]].mean()))
            confs.append(float(found.conf[1].mean()))
        yield {"data": truth.name, "view": how, "confidence": float(np.mean(confs)), "abs_rel": float(np.mean(errors))}


def spoilt(frame: Any, how: str) -> Any:
    """A frame whose picture is worse than it was; its depth and pose stay."""
    from dataclasses import replace

    import cv2

    from realsim.core.types import Intrinsics

    color = frame.color()
    camera = frame.color_intrinsics or frame.intrinsics
    if how == "night":
        noise = np.random.default_rng(0).normal(0, 3, color.shape)
        color = np.clip(color * 0.03 + noise, 0, 255).astype(np.uint8)
    elif how == "overexposed":
        color = np.clip(color.astype(np.float32) * 5, 0, 255).astype(np.uint8)
    elif how == "blurred":
        color = cv2.blur(color, (41, 1))
    elif how == "wide crop":
        rows = camera.width // 3
        top = (camera.height - rows) // 2
        color = color[top : top + rows]
        camera = Intrinsics(camera.width, rows, camera.fx, camera.fy, camera.cx, camera.cy - top)
    return replace(frame, read_color=lambda: color, color_intrinsics=camera)


def timed(model_file: Path, truth: Truth) -> Row:
    """Seconds for all frames of a capture through realsim's own runner (windows, joins), two threads."""
    import time

    import onnxruntime

    from realsim.feedforward.config import OnnxConfig
    from realsim.feedforward.onnx.runner import predict
    from realsim.feedforward.onnx.session import open_model

    model = open_model(model_file)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 2
    object.__setattr__(
        model, "session", onnxruntime.InferenceSession(str(model_file), options, providers=["CPUExecutionProvider"])
    )
    clock, cpu = time.perf_counter(), time.process_time()
    row: Row = {"data": truth.name, "frames": len(truth.frames)}
    try:
        found = predict(truth.frames, model, OnnxConfig(model=model_file), with_depth=False, poses=True, kept_in=None)
        row["placed"] = len(found.used)
    except RealsimError as error:  # of a network that is not good enough, the runner refuses what it says
        row["placed"], row["refused"] = 0, error.message
    return {**row, "seconds": time.perf_counter() - clock, "cpu_seconds": time.process_time() - cpu}


# ---------------------------------------------------------------- printing


def line(row: Row) -> str:
    """A row for a person, with its bars."""
    out = []
    for key, value in row.items():
        out.append(f"{key} {value:.4g}{_judged(row, key, value)}" if isinstance(value, float) else f"{key} {value}")
    if "seconds" in row:
        out.append(f"bar {BAR_SECONDS:g} s for 60 frames on two free cores")
    return "  ".join(out)


def _judged(row: Row, key: str, value: float) -> str:
    bar = BARS.get(str(row.get("given")), {}).get(key)
    if bar is None or not np.isfinite(value):
        return ""
    if key == "rotation_deg" and row["still_deg"] <= bar:
        return f" (bar {bar:g}: says nothing, no motion at all meets it)"
    return f" (bar {bar:g}: {'met' if value <= bar else 'missed'})"


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--state", type=Path, help="folder of a state, or an exported file: generated scenes")
    parser.add_argument("--model", type=Path, help="ONNX file: captures")
    parser.add_argument("--captures", type=Path, nargs="*", default=[])
    parser.add_argument("--real", type=Path, nargs="*", default=[])
    parser.add_argument("--size", type=int, nargs=2, default=(240, 320))
    parser.add_argument("--scenes", type=int, default=64, help="of every kind")
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    rows: list[Row] = []
    try:
        for row in _rows(o):
            print(line(row), flush=True)
            rows.append(row)
        if o.json:
            from realsim.core.files import write_text

            write_text(o.json, "[\n" + ",\n".join(json.dumps(r) for r in rows) + "\n]\n")
    except RealsimError as error:
        print(error.render(), file=sys.stderr)
        sys.exit(2)


def _rows(o: argparse.Namespace) -> Iterator[Row]:
    if not o.state and not (o.model and (o.captures or o.real)):
        raise RealsimError("nothing to measure", expected="--state RUN, or --model FILE.onnx with --captures or --real")
    if o.state:
        yield from generated(shipped.any_of(o.state).net, tuple(o.size), o.scenes, o.views, o.device)
    for folder in o.captures if o.model else ():
        truth = read(folder)
        yield from captured(o.model, truth)
        yield from doubts(o.model, truth)
        yield timed(o.model, truth)
    for folder in o.real if o.model else ():
        yield from captured(o.model, read_real(folder))


if __name__ == "__main__":
    main()
