"""One writer a layout: a walk of exact views to files, by the layout's own conventions."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from realsim.geometry import R_to_quat

from .scene import CAMERA, View


def write_image(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)


def millimetres(depth: np.ndarray, steps: float = 1000.0) -> np.ndarray:
    return np.rint(depth * steps).astype(np.uint16)


def write_folders(folder: Path, views: Sequence[View], color: str = "color", ext: str = "png") -> None:
    for i, view in enumerate(views):
        write_image(folder / color / f"{i:06d}.{ext}", view.color)
        write_image(folder / "depth" / f"{i:06d}.png", millimetres(view.depth))


def column_major(camera=CAMERA) -> dict:
    return {"width": camera.width, "height": camera.height, "intrinsic_matrix": camera.K.T.ravel().tolist()}


def write_open3d(folder: Path, views: Sequence[View]) -> None:
    write_folders(folder, views)
    (folder / "camera_intrinsic.json").write_text(json.dumps(column_major()))
    write_log(folder / "trajectory.log", [v.T_world_camera for v in views])


def write_log(path: Path, poses: Sequence[np.ndarray], first: int = 0) -> None:
    lines = []
    for i, T in enumerate(poses, first):
        lines += [f"{i} {i} {i + 1}", *(" ".join(f"{v:.12f}" for v in row) for row in T)]
    path.write_text("\n".join(lines) + "\n")


def write_tum(folder: Path, views: Sequence[View], depth_delay: float = 0.004) -> None:
    color_list, depth_list = ["# color images"], ["# depth maps"]
    poses = ["# timestamp tx ty tz qx qy qz qw"]
    for view in views:
        write_image(folder / f"rgb/{view.time:.6f}.png", view.color)
        write_image(folder / f"depth/{view.time + depth_delay:.6f}.png", millimetres(view.depth, 5000))
        color_list.append(f"{view.time:.6f} rgb/{view.time:.6f}.png")
        depth_list.append(f"{view.time + depth_delay:.6f} depth/{view.time + depth_delay:.6f}.png")
        w, x, y, z = R_to_quat(view.T_world_camera[:3, :3])
        poses.append(" ".join(f"{v:.9f}" for v in (view.time, *view.T_world_camera[:3, 3], x, y, z, w)))
    c = CAMERA
    (folder / "calibration.txt").write_text(f"# fx fy cx cy w h\n{c.fx} {c.fy} {c.cx} {c.cy} {c.width} {c.height}\n")
    for name, lines in (("rgb", color_list), ("depth", depth_list), ("groundtruth", poses)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")


def write_sevenscenes(folder: Path, views: Sequence[View]) -> None:
    for i, view in enumerate(views):
        raw = millimetres(view.depth)
        raw[raw == 0] = 65535
        write_image(folder / f"frame-{i:06d}.color.png", view.color)
        write_image(folder / f"frame-{i:06d}.depth.png", raw)
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", view.T_world_camera)
    np.savetxt(folder / "camera-intrinsics.txt", CAMERA.K)


def write_scannet(folder: Path, views: Sequence[View]) -> None:
    of_color = CAMERA.resized(2 * CAMERA.width, 2 * CAMERA.height)
    for i, view in enumerate(views):
        big = cv2.resize(view.color, (of_color.width, of_color.height), interpolation=cv2.INTER_NEAREST)
        write_image(folder / f"color/{i}.png", big)
        write_image(folder / f"depth/{i}.png", millimetres(view.depth))
        (folder / "pose").mkdir(exist_ok=True)
        np.savetxt(folder / f"pose/{i}.txt", view.T_world_camera)
    (folder / "intrinsic").mkdir()
    for which, camera in (("color", of_color), ("depth", CAMERA)):
        K = np.eye(4)
        K[:3, :3] = camera.K
        np.savetxt(folder / f"intrinsic/intrinsic_{which}.txt", K)
        np.savetxt(folder / f"intrinsic/extrinsic_{which}.txt", np.eye(4))


def write_plain(folder: Path, views: Sequence[View]) -> None:
    write_folders(folder, views, "rgb")
    c = CAMERA
    (folder / "intrinsics.yaml").write_text(
        f"fx: {c.fx}\nfy: {c.fy}\ncx: {c.cx}\ncy: {c.cy}\nwidth: {c.width}\nheight: {c.height}\n"
    )


def write_pcd_folder(folder: Path, views: Sequence[View]) -> None:
    for i, view in enumerate(views):
        write_pcd(folder / f"cloud{i:03d}.pcd", camera_points(view), view.color)


def camera_points(view: View) -> np.ndarray:
    """(H, W, 3) optical-frame points, NaN where there is no depth."""
    points = CAMERA.rays().astype(float) * view.depth[..., None]
    points[view.depth == 0] = np.nan
    return points


def write_pcd(
    path: Path,
    points: np.ndarray,
    color: np.ndarray | None = None,
    viewpoint: str = "0 0 0 1 0 0 0",
    data: str = "binary",
) -> None:
    """An organised PCD file of (H, W, 3) points."""
    height, width = points.shape[:2]
    fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")] + ([("rgb", "<u4")] if color is not None else [])
    table = np.zeros(height * width, dtype=fields)
    for k, axis in enumerate("xyz"):
        table[axis] = points[..., k].ravel()
    if color is not None:
        r, g, b = color.reshape(-1, 3).astype(np.uint32).T
        table["rgb"] = r << 16 | g << 8 | b
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(n for n, _ in fields),
        "SIZE " + " ".join("4" for _ in fields),
        "TYPE F F F" + (" U" if color is not None else ""),
        "COUNT " + " ".join("1" for _ in fields),
        f"WIDTH {width}",
        f"HEIGHT {height}",
        f"VIEWPOINT {viewpoint}",
        f"POINTS {height * width}",
        f"DATA {data}",
    ]
    if data == "binary":
        body = table.tobytes()
    else:
        body = "\n".join(" ".join(str(v) for v in row) for row in table.tolist()).encode() + b"\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(("\n".join(header) + "\n").encode() + body)


WRITERS: dict[str, Callable[[Path, Sequence[View]], None]] = {
    "open3d": write_open3d,
    "tum": write_tum,
    "sevenscenes": write_sevenscenes,
    "scannet": write_scannet,
    "pcd": write_pcd_folder,
    "plain": write_plain,
}
WITHOUT_POSES = {"pcd", "plain"}
