"""A scene for Foxglove (and other viewers of MCAP): surface, collision geometry and platforms as one SceneUpdate."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from realsim.core.mcap_file import TIME, stamped, write_mcap
from realsim.export.formats.scene import SceneOnDisk

SCENE: Mapping[str, Any] = {
    "type": "object",
    "properties": {
        "deletions": {"type": "array", "items": {"type": "object"}},
        "entities": {"type": "array", "items": {"type": "object", "properties": {"timestamp": TIME}}},
    },
}
_SURFACE = {"r": 0.6, "g": 0.6, "b": 0.6, "a": 1.0}
_COLLISION = {"r": 0.2, "g": 0.5, "b": 0.9, "a": 0.4}
_SITE = {"r": 0.1, "g": 0.7, "b": 0.3, "a": 0.6}


def foxglove(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """`scene.mcap`: topics /surface, /collision and /platforms of the schema foxglove.SceneUpdate, frame `world`."""
    cubes = [_cube(b.position, b.rotation, b.half, _COLLISION) for b in scene.all_boxes()]
    parts = [_triangles(c.vertices, c.triangles, _COLLISION) for c in (*scene.convex, *scene.surfaces)]
    sites = [_cube(center, np.eye(3), half, _SITE) for center, half in scene.sites.values()]
    colors = None if scene.colors is None else scene.colors / 255.0
    entities = {
        "/surface": {"triangles": [_triangles(scene.vertices, scene.triangles, _SURFACE, colors)]},
        "/collision": {"cubes": cubes, "triangles": parts},
        "/platforms": {"cubes": sites},
    }
    path = folder / "scene.mcap"
    messages = [(topic, 0.0, {"deletions": [], "entities": [_entity(topic, e)]}) for topic, e in entities.items()]
    write_mcap(path, dict.fromkeys(entities, ("foxglove.SceneUpdate", SCENE)), messages)
    return [path]


def _entity(name: str, shapes: Mapping[str, Any]) -> dict[str, Any]:
    empty: dict[str, Any] = {k: [] for k in ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts")}
    whole = {"timestamp": stamped(0.0), "frame_id": "world", "id": name, "lifetime": stamped(0.0)}
    return whole | {"frame_locked": False, "metadata": [], "models": []} | empty | dict(shapes)


def _cube(center: Any, rotation: Any, half: Any, color: Mapping[str, float]) -> dict[str, Any]:
    return {"pose": _pose(center, rotation), "size": _xyz(2 * np.asarray(half)), "color": color}


def _triangles(vertices: Any, faces: Any, color: Mapping[str, float], colors: Any = None) -> dict[str, Any]:
    """Vertices to a tenth of a millimetre: JSON is text."""
    each = (
        [] if colors is None else [dict(zip("rgba", (*map(float, np.round(c, 3)), 1.0), strict=True)) for c in colors]
    )
    points = [_xyz(v) for v in np.round(vertices, 4)]
    indices = np.asarray(faces).ravel().tolist()
    return {"pose": _pose(np.zeros(3), np.eye(3)), "points": points, "color": color, "colors": each, "indices": indices}


def _pose(center: Any, rotation: Any) -> dict[str, Any]:
    quaternion = dict(zip("xyzw", Rotation.from_matrix(rotation).as_quat().tolist(), strict=True))
    return {"position": _xyz(center), "orientation": quaternion}


def _xyz(vector: Any) -> dict[str, float]:
    return dict(zip("xyz", np.asarray(vector, float).tolist(), strict=True))
