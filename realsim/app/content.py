"""What a file or folder is, and what can be done with it: by its name and files alone, in milliseconds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

MESHES = (".obj", ".stl", ".glb", ".gltf", ".off", ".ply", ".dae", ".3mf")
CLOUDS = (".las", ".laz", ".pcd", ".e57", ".xyz")
RECORDINGS = (".mcap", ".bag", ".db3", ".csv", ".tsv", ".parquet", ".ulg", ".ulog", ".npz", ".rrd", ".pt", ".jsonl")
POLICIES = (".onnx",)


@dataclass(frozen=True)
class Content:
    """A kind, the command that looks at it, and the actions that fit."""

    kind: str
    """scene, diagnosis, case, policy, recording, mesh, scan or capture."""
    words: str
    look: tuple[str, ...]
    """Arguments of the command that says what is recognised; empty where the page shows a finished result."""
    actions: tuple[str, ...]


def content_of(path: Path) -> Content:
    """What is at a path. Whatever is nothing else is looked at as a capture, whose reader says what is missing."""
    here = str(path)
    if path.is_dir():
        if (path / "diagnosis.json").is_file():
            return Content("diagnosis", "a finished diagnosis", (), ("report", "use"))
        if (path / "scene.xml").is_file() and any((path / n).is_file() for n in ("report.json", "contact.json")):
            return Content("scene", "a finished scene", (), ("report", "export", "finetune", "use"))
        if (path / "log.json").is_file():
            return Content("case", "a case: runs with a model", ("diagnose", here, "--check"), ("diagnose",))
        files = [p for p in path.iterdir() if p.is_file()]
        known = [p for p in files if p.suffix.lower() in RECORDINGS]
        if known and len(known) >= len(files) / 2 and not any(p.is_dir() for p in path.iterdir()):
            return Content("recording", "a folder of recordings", ("log", here), ("log",))
        return Content("capture", "a capture: a folder of frames", ("inspect", here), ("reconstruct",))
    suffix = path.suffix.lower()
    if suffix in POLICIES:
        return Content("policy", "a policy or model in ONNX", ("model", "inspect", here), ())
    if suffix in RECORDINGS:
        return Content("recording", "a robot's recording", ("log", here), ("log", "reconstruct"))
    if suffix in CLOUDS:
        return Content("scan", "a scan: a cloud of points", ("inspect", here), ("reconstruct",))
    if suffix in MESHES:
        return Content("mesh", "a mesh or scan", ("inspect", here), ("contact", "reconstruct"))
    return Content("capture", "a capture", ("inspect", here), ("reconstruct",))
