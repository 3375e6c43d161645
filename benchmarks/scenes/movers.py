"""Rendered captures with somebody who moves, or with something that moves with the camera: what is left of it?

    python -m benchmarks.scenes.movers [--kinds hand stands] [--poses estimate]

`cross`, `along`, `ahead`: somebody walks across the course, beside it, before the camera; `stands` for half of the
frames and leaves; `shifts` from foot to foot. `foot`, `shin`, `hand`, `bumper`, `big`: carried, 3 to 37 % of the
picture. False is surface of the mesh more than 3 cm from any true one. Rows go to benchmarks/results/movers.json.
"""

import argparse
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.store import Store
from realsim.core.errors import RealsimError
from realsim.core.geometry import exp_so3, transform
from realsim.pipeline import ReconstructConfig, reconstruct
from realsim.synth import SynthConfig
from realsim.synth import capture as synth
from realsim.synth.camera import DepthSensor, rig
from realsim.synth.errors import Samples, Surface, compare, read_surface, register
from realsim.synth.render import Renderer
from realsim.synth.solids import Solid, box, rz
from realsim.synth.terrain import Terrain, make_terrain
from realsim.synth.truth import read_truth, sample_truth, write_truth

ROOT = Path(__file__).resolve().parents[2]
WALKS = ("cross", "along", "ahead", "stands", "shifts")
CARRIED: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], bool]] = {
    "foot": ((0.10, 0.24, 0.07), (0.0, 0.27, 0.55), False),
    "shin": ((0.10, 0.10, 0.45), (0.12, 0.42, 0.5), True),
    "hand": ((0.09, 0.10, 0.18), (0.16, 0.22, 0.38), True),
    "bumper": ((0.9, 0.12, 0.12), (0.0, 0.30, 0.55), False),
    "big": ((0.9, 0.3, 0.3), (0.0, 0.24, 0.6), False),
}
"""Size, place before the camera (x right, y down, z forward), and whether it stands upright there; metres."""


def bodies(kind: str, i: int, count: int, T: np.ndarray, terrain: Terrain) -> list[Solid]:
    """What is there in frame `i` of `count` besides the terrain, with a texture of its own that goes along."""
    (low, *_), (high, *_) = terrain.bounds
    share, middle = i / (count - 1), (low + high) / 2
    if kind in CARRIED:
        size, at, upright = CARRIED[kind]
        solid = _own(box("carried", size, "foam" if kind == "hand" else "cardboard"))
        return [solid.moved(exp_so3([np.pi / 2 * upright, 0, 0]), at).moved(T[:3, :3], T[:3, 3])]
    if kind == "along":
        return _person(low - 0.3 + share * (high - low + 0.6), 0.55, 0.0, 0.2 * np.sin(2.2 * i))
    if kind == "ahead":
        x, y, _ = T[:3, 3] + 1.7 * T[:3, 2]
        return _person(x, y, 0.0, 0.2 * np.sin(2.2 * i))
    if kind == "stands":
        return _person(middle, 0.45, 0.0, 0.02) if i < count // 2 else []
    if kind == "shifts":
        return _person(middle + 0.05 * np.sin(1.3 * i), 0.45 + 0.04 * np.cos(2.1 * i), 0.2 * np.sin(0.9 * i), 0.02)
    t = (i - count // 3) / (count // 3)
    across = low + (0.35 + 0.1 * t) * (high - low)
    return _person(across, 3.0 * t - 1.2, np.pi / 2, 0.2 * np.sin(2.2 * i)) if 0 <= t < 1 else []


def _person(x: float, y: float, yaw: float, stride: float) -> list[Solid]:
    parts = (
        box("leg", (0.16, 0.16, 0.85), "foam").moved(np.eye(3), (stride, 0.12, 0)),
        box("leg", (0.16, 0.16, 0.85), "foam").moved(np.eye(3), (-stride, -0.12, 0)),
        box("trunk", (0.28, 0.48, 0.6), "cardboard").moved(np.eye(3), (0, 0, 0.85)),
        box("head", (0.2, 0.18, 0.25), "painted").moved(np.eye(3), (0, 0, 1.48)),
    )
    return [_own(part).moved(rz(yaw), (x, y, 0)) for part in parts]


def _own(solid: Solid) -> Solid:
    return replace(solid, texture_origin=np.zeros(3))


def made(kind: str, folder: Path, config: SynthConfig) -> None:
    """`folder/capture` and `folder/truth`, as `realsim.synth.write_capture` makes them."""
    terrain = make_terrain(config.terrain, config.seed, config.once)
    rng = np.random.default_rng([config.seed, 4])
    scale = float(rng.uniform(0.99, 1.01))
    T_world_sim = synth._random_world(rng)
    poses = synth.camera_poses(terrain, config, rng)
    cameras = rig(config.sensor, config.width, np.random.default_rng([config.seed, 7]))
    for i, T in enumerate(poses):
        solids = (*terrain.solids, *bodies(kind, i, len(poses), T, terrain))
        depth, color = (Renderer(solids, k, config.seed, terrain.lamps) for k in (cameras.depth, cameras.color))
        synth._write_frame(folder / "capture", cameras, depth, color, DepthSensor(scale), config, i, T)
    synth._write_cameras(folder / "capture", cameras, T_world_sim @ poses, config)
    plain = Renderer(terrain.solids, cameras.depth, config.seed, terrain.lamps)
    about = {"depth": asdict(cameras.depth), "color": asdict(cameras.color), "T_depth_color": cameras.T_depth_color}
    truth = {"config": asdict(config), "depth_scale": scale, "sensor": {}, "cameras": about}
    write_truth(folder / "truth", terrain, sample_truth(terrain, plain, poses), T_world_sim, poses, truth)


def row(kind: str, poses: str, folder: Path) -> dict[str, Any]:
    """One capture, reconstructed by default."""
    about = {"kind": kind, "poses": poses}
    made(kind, folder, SynthConfig("mixed", frames=40, width=320, poses=True))
    config = ReconstructConfig()
    config = replace(config, points=replace(config.points, poses=poses))
    try:
        found = reconstruct(folder / "capture", folder / "scene", config)
    except RealsimError as error:
        return about | {"refused": error.message}
    samples = read_truth(folder / "truth")[1]
    seen = samples.seen >= 2
    target = Samples(samples.points[seen], samples.normals[seen], samples.solid[seen], samples.seen[seen])
    mesh, true = read_surface(folder / "scene" / "mesh.ply"), read_surface(folder / "truth" / "mesh.ply")
    T = register(mesh, target, scale=False).T
    corners = transform(T, found.mesh.vertices)[found.mesh.triangles[~found.mesh.invented]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    middle = corners.mean(1)
    off = np.linalg.norm(Surface(true.vertices, true.triangles).closest(middle) - middle, axis=1)
    figures = compare(folder / "scene", folder / "truth")
    return about | {
        "frames": len(found.aligned.metric or ()),
        "f_1cm": round(figures["f_score_1cm"], 4),
        "tops_mm": round(figures["tops_mm"], 3),
        "area_m2": round(float(area.sum()), 2),
        "false_m2": round(float(area[off > 0.03].sum()), 4),
        "geoms": sum(found.scene.contact["geoms"].values()),
        "said": next(
            (w for w in (*found.aligned.cropped, *found.warnings) if "moves with" in w or "moved there" in w), ""
        ),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="*", default=[*WALKS, *CARRIED])
    parser.add_argument("--poses", nargs="*", default=["given"], choices=["given", "estimate"])
    args = parser.parse_args()
    store = Store(ROOT / "benchmarks" / "results" / "movers.json", ("kind", "poses"))
    for kind in args.kinds:
        for poses in args.poses:
            with tempfile.TemporaryDirectory() as folder:
                measured = row(kind, poses, Path(folder))
            store.add(measured)
            print("  ".join(f"{key} {value}" for key, value in measured.items()), flush=True)


if __name__ == "__main__":
    main()
