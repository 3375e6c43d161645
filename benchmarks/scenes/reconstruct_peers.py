"""What others would do with the same frames: Open3D's reconstruction steps, and plain TSDF with the true poses."""

from pathlib import Path
from typing import Any

import numpy as np

from realsim import capture
from realsim.capture.config import CaptureConfig
from realsim.core.geometry import invert_T, transform
from realsim.core.types import Frame

VOXEL = 0.01
DEPTH_MAX = 3.0
KEYFRAME_EVERY = 5


def tsdf_with_true_poses(source: Path, out: Path, truth: dict[str, Any]) -> dict[str, Any]:
    """Fuse all frames at 1 cm with the exact poses; the mesh is brought into the true simulation frame."""
    frames = capture.read(source, CaptureConfig()).frames
    poses = np.asarray(truth["T_world_camera"])[_indices(frames, truth["names"])]
    mesh = fuse(frames, poses)
    return _write(mesh, np.asarray(truth["T_sim_world"]), out) | {"frames": len(frames)}


def open3d_steps(source: Path, out: Path, truth: dict[str, Any]) -> dict[str, Any]:
    """RGB-D odometry between neighbours and between keyframes, a pose graph, TSDF fusion: Open3D's public functions.

    The parameters are those of Open3D's own example configuration (hybrid term, 3 m, keyframes every 5 frames, loop
    preference 0.1, pruning 0.25). Keyframe pairs start from the chained odometry. The result has no notion of up:
    it is placed by the true pose of its first camera.
    """
    frames = capture.read(source, CaptureConfig()).frames
    poses = _pose_graph(frames)
    mesh = fuse(frames, poses)
    first = np.asarray(truth["T_world_camera"])[_indices(frames, truth["names"])[0]]
    T_sim_found = np.asarray(truth["T_sim_world"]) @ first @ invert_T(poses[0])
    return _write(mesh, T_sim_found, out) | {"frames": len(frames)}


def fuse(frames: tuple[Frame, ...], T_world_camera: np.ndarray) -> Any:
    """A 1 cm TSDF (VoxelBlockGrid) of the frames, as a legacy Open3D mesh in the poses' world."""
    import open3d as o3d

    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (o3d.core.float32, o3d.core.float32), ((1), (1)), VOXEL, 16, 20_000
    )
    for frame, T in zip(frames, T_world_camera, strict=True):
        depth = o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(frame.depth()[..., None])))
        K, E = o3d.core.Tensor(frame.intrinsics.K), o3d.core.Tensor(invert_T(T))
        blocks = grid.compute_unique_block_coordinates(depth, K, E, 1.0, DEPTH_MAX)
        grid.integrate(blocks, depth, K, E, 1.0, DEPTH_MAX)
    return grid.extract_triangle_mesh(weight_threshold=2.0).to_legacy()


def _pose_graph(frames: tuple[Frame, ...]) -> np.ndarray:
    """(N, 4, 4) camera to world, the world being the first camera."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    images = [_rgbd(f) for f in frames]
    graph = registration.PoseGraph()
    T = np.eye(4)
    graph.nodes.append(registration.PoseGraphNode(T))
    for i in range(1, len(frames)):
        ok, step, information = _odometry(images[i - 1], images[i], np.eye(4), frames[i])
        T = (step if ok else np.eye(4)) @ T
        graph.nodes.append(registration.PoseGraphNode(np.linalg.inv(T)))
        graph.edges.append(registration.PoseGraphEdge(i - 1, i, step, information, uncertain=False))
    keys = range(0, len(frames), KEYFRAME_EVERY)
    for a in keys:
        for b in keys:
            if b <= a + 1:
                continue
            start = invert_T(graph.nodes[b].pose) @ graph.nodes[a].pose
            if np.linalg.norm(start[:3, 3]) > 1.0:
                continue
            ok, step, information = _odometry(images[a], images[b], start, frames[b])
            if ok:
                graph.edges.append(registration.PoseGraphEdge(a, b, step, information, uncertain=True))
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(
            max_correspondence_distance=0.07, edge_prune_threshold=0.25, preference_loop_closure=0.1, reference_node=0
        ),
    )
    return np.stack([n.pose for n in graph.nodes])


def _rgbd(frame: Frame) -> Any:
    import cv2
    import open3d as o3d

    color = frame.color()
    assert color is not None, "Open3D's odometry needs colour"
    size = (frame.intrinsics.width, frame.intrinsics.height)
    color = np.ascontiguousarray(cv2.resize(color, size) if color.shape[1::-1] != size else color)
    depth = o3d.geometry.Image(np.ascontiguousarray(frame.depth()))
    return o3d.geometry.RGBDImage.create_from_color_and_depth(o3d.geometry.Image(color), depth, 1.0, DEPTH_MAX)


def _odometry(source: Any, target: Any, start: np.ndarray, frame: Frame) -> tuple[bool, np.ndarray, np.ndarray]:
    import open3d as o3d

    k = frame.intrinsics
    camera = o3d.camera.PinholeCameraIntrinsic(k.width, k.height, k.fx, k.fy, k.cx, k.cy)
    odometry = o3d.pipelines.odometry
    term = odometry.RGBDOdometryJacobianFromHybridTerm()
    return odometry.compute_rgbd_odometry(source, target, camera, start, term, odometry.OdometryOption())


def _indices(frames: tuple[Frame, ...], names: list[str]) -> list[int]:
    """Which true pose belongs to which frame; by number, in the order of the files."""
    order = sorted(f.files[0].name for f in frames)
    assert len(order) == len(names), f"{len(order)} frames were read, {len(names)} have a true pose"
    at = {name: i for i, name in enumerate(order)}
    return [at[f.files[0].name] for f in frames]


def _write(mesh: Any, T_sim_world: np.ndarray, out: Path) -> dict[str, Any]:
    import open3d as o3d

    out.mkdir(parents=True, exist_ok=True)
    mesh.vertices = o3d.utility.Vector3dVector(transform(T_sim_world, np.asarray(mesh.vertices)))
    o3d.io.write_triangle_mesh(str(out / "mesh.ply"), mesh)
    return {"triangles": len(mesh.triangles)}
