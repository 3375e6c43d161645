"""From the frames of a capture to a policy for its course, judged on the course itself and not on the reconstruction.

    python benchmarks/training/captures.py prepare           CPU: scenes, and the exact courses from the captures' truth
    python benchmarks/training/captures.py run --minutes 1   GPU: `realsim finetune` on each scene, then trials

The captures of REALSIM_SHARED/captures come from a renderer and course generator that are not ours; no base saw them.
The exact course is each true part's hull. A row names the scene by its mesh, and has the trials that the base and what
`finetune` delivers won.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import mujoco
import numpy as np
import trimesh
import tyro

from benchmarks.store import Row, Store
from benchmarks.training.base_policy import SETTINGS, fingerprint, outcomes
from realsim.core.files import read_json
from trainer.commands.common import load_policy
from trainer.evaluate import EvaluationConfig
from trainer.policies import base_of
from trainer.ppo.distributed import pick_device
from trainer.terrain.base import Platform, Terrain

ROOT = Path(__file__).resolve().parents[2]
SHARED = Path(os.environ.get("REALSIM_SHARED", ROOT.parent / "shared"))
KEY = ("robot", "base", "capture", "scene", "minutes", "setting", "seed")


@dataclass(frozen=True)
class Options:
    do: Annotated[Literal["prepare", "run"], tyro.conf.Positional]
    captures: tuple[str, ...] = ("stake_a", "narrow_a", "mixed_a")
    robot: str = "g1"
    minutes: float = 1.0
    """Of fine-tuning."""
    trials: int = 1000
    settings: tuple[str, ...] = ("mild", "full")
    """See base_policy.SETTINGS."""
    worlds: int = 0
    seed: int = 0
    device: str = "auto"
    work: Path = Path("out/captures")
    """Scenes, exact courses, policies."""
    store: Path = ROOT / "benchmarks" / "results" / "tuned_captures.json"


def main(options: Options) -> None:
    for name in options.captures:
        prepare(name, options) if options.do == "prepare" else run(name, options)


def prepare(name: str, options: Options) -> None:
    """The scene by the command's defaults, and the truth without what only a renderer needs."""
    folder = options.work / name
    _realsim("reconstruct", SHARED / "captures" / name / "capture", "--out", folder / "scene", "--overwrite")
    truth = SHARED / "captures" / name / "gt"
    facts, mesh = read_json(truth / "gt.json"), trimesh.load_mesh(truth / "gt_mesh.ply", process=False)
    owner = np.load(truth / "gt_faces.npz")["prim"]
    parts = [np.asarray(mesh.vertices)[np.unique(mesh.faces[owner == k])] for k in range(owner.max() + 1)]
    hulls = [trimesh.PointCloud(p).convex_hull.vertices.round(5).tolist() for p in parts]
    kept = {key: facts[key] for key in ("start_platform", "goal_platform", "floor_z_sim")}
    (folder / "exact.json").write_text(json.dumps(kept | {"parts": hulls}))


def exact(folder: Path) -> Terrain:
    """The true course as convex parts, which collide and which rays hit."""
    facts = read_json(folder / "exact.json")
    hulls = [trimesh.PointCloud(np.array(points)).convex_hull for points in facts["parts"]]
    spec = mujoco.MjSpec()
    for i, hull in enumerate(hulls):
        spec.add_mesh(name=f"part{i}", uservert=hull.vertices.ravel(), maxhullvert=64)
        spec.worldbody.add_geom(name=f"part{i}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"part{i}")
    whole = trimesh.util.concatenate(hulls)
    ends = [
        Platform(np.array(end["top_centroid_sim"]), np.array(end["size_m"][:2]))
        for end in (facts["start_platform"], facts["goal_platform"])
    ]
    vertices, triangles = np.asarray(whole.vertices, np.float64), np.asarray(whole.faces, np.int32)
    return Terrain(folder.name, (), vertices, triangles, *ends, floor_z=facts["floor_z_sim"], contact=spec)


def run(name: str, options: Options) -> None:
    """Fine-tune on the scene, and count the trials that the base and what is delivered win on the exact course."""
    folder, base = options.work / name, base_of(options.robot)
    tuned = folder / "tuned"
    sizes = ("--minutes", options.minutes, "--worlds", options.worlds, "--final-trials", options.trials)
    where = ("--policy", base, "--out", tuned, "--overwrite", "--device", options.device, "--seed", options.seed)
    _realsim("finetune", folder / "scene", *where, *sizes)
    result, scene = read_json(tuned / "result.json"), fingerprint(folder / "scene" / "mesh.ply")
    for setting in options.settings:
        won = {kind: counts(file, folder, setting, options) for kind, file in (("base", base), ("tuned", tuned))}
        identity = (options.robot, fingerprint(base), name, scene, options.minutes, setting, options.seed)
        row: Row = dict(zip(KEY, identity, strict=True)) | {"trials": options.trials}
        row |= {f"won_{kind}": c["success"] for kind, c in won.items()} | {"causes": dict(won["tuned"])}
        row |= {"iterations": result["result"]["iterations"], "helped": result["helped"]}
        print(Store(options.store, KEY).add(row), flush=True)


def counts(file: Path, folder: Path, setting: str, options: Options) -> Any:
    """How trials on the exact course end."""
    task, pushes = SETTINGS[setting]
    policy = load_policy(file / "policy.pt" if file.is_dir() else file)
    many = EvaluationConfig(trials=options.trials, seed=options.seed + 7, pushes=pushes)
    return outcomes(policy, [exact(folder)], task, many, pick_device(options.device))[0]


def _realsim(*command: Any) -> None:
    subprocess.run([sys.executable, "-m", "realsim", *map(str, command)], check=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
