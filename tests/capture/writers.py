"""One writer a layout: a walk of exact views to files, by the layout's own conventions."""

import json
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from realsim.core.geometry import R_to_quat, invert_T

from .fake_realsense import write_bag
from .rosbags_of import write_bag as write_ros
from .scene import CAMERA, START_TIME, View


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


def write_replica(folder: Path, views: Sequence[View]) -> None:
    c = CAMERA
    for i, view in enumerate(views):
        write_image(folder / f"results/frame{i:06d}.png", view.color)
        write_image(folder / f"results/depth{i:06d}.png", np.rint(view.depth * 6553.5).astype(np.uint16))
    np.savetxt(folder / "traj.txt", [view.T_world_camera.ravel() for view in views])
    camera = {"w": c.width, "h": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "scale": 6553.5}
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera}))


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


def write_bop(folder: Path, views: Sequence[View]) -> None:
    write_folders(folder, views, "rgb")
    cameras = {}
    for i, view in enumerate(views):
        T = invert_T(view.T_world_camera)
        pose = {"cam_R_w2c": T[:3, :3].ravel().tolist(), "cam_t_w2c": (1000 * T[:3, 3]).tolist()}
        cameras[str(i)] = {"cam_K": CAMERA.K.ravel().tolist(), "depth_scale": 1.0, **pose}
    (folder / "scene_camera.json").write_text(json.dumps(cameras))


RTABMAP_CALIBRATION = """%YAML:1.0
---
camera_name: "{name}"
image_width: {width}
image_height: {height}
camera_matrix:
   rows: 3
   cols: 3
   data: [ {fx}, 0., {cx}, 0., 0., {fy}, {cy}, 0., 0. ]
projection_matrix:
   rows: 3
   cols: 4
   data: [ {fx}, 0., {cx}, 0., 0., {fy}, {cy}, 0., 0., 0., 1., 0. ]
local_transform:
   rows: 3
   cols: 4
   data: [ 0., 0., 1., 0.1, -1., 0., 0., 0., 0., -1., 0., 0.2 ]
"""
ON_ROBOT = np.array([[0.0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.2], [0, 0, 0, 1]])
"""The camera of RTABMAP_CALIBRATION, in the robot."""


def write_rtabmap(folder: Path, views: Sequence[View], by: str = "node", of: str = "poses") -> None:
    """The names of the files are `node` or `time`; the poses of the robot (`poses`) or of the camera."""
    (folder / "map_calib").mkdir(parents=True)
    rows = ["#timestamp x y z qx qy qz qw id"]
    for i, view in enumerate(views):
        name = f"{3 * i + 1}" if by == "node" else f"{view.time:.6f}"
        write_image(folder / f"map_rgb/{name}.png", view.color)
        write_image(folder / f"map_depth/{name}.png", millimetres(view.depth))
        c = CAMERA
        figures = {"fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "width": c.width, "height": c.height}
        (folder / f"map_calib/{name}.yaml").write_text(RTABMAP_CALIBRATION.format(name=name, **figures))
        T = view.T_world_camera @ (invert_T(ON_ROBOT) if of == "poses" else np.eye(4))
        w, x, y, z = R_to_quat(T[:3, :3])
        rows.append(" ".join(f"{v:.9f}" for v in (view.time, *T[:3, 3], x, y, z, w)) + f" {3 * i + 1}")
    (folder / f"map_{of}.txt").write_text("\n".join(rows) + "\n")


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


OPENGL = np.diag([1.0, -1, -1, 1])
OF_COLOR = CAMERA.resized(2 * CAMERA.width, 2 * CAMERA.height)
"""The camera of phones' colour images, which have more pixels than their depth."""


def enlarged(view: View) -> np.ndarray:
    return cv2.resize(view.color, (OF_COLOR.width, OF_COLOR.height), interpolation=cv2.INTER_NEAREST)


def write_jpeg(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(jpeg(image))


def jpeg(image: np.ndarray) -> bytes:
    """As little lossy as JPEG can be: no colour subsampling."""
    how = [cv2.IMWRITE_JPEG_QUALITY, 100, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    return cv2.imencode(".jpg", image[..., ::-1], how)[1].tobytes()


def write_nerfstudio(folder: Path, views: Sequence[View]) -> None:
    frames = []
    for i, view in enumerate(views):
        write_image(folder / f"images/frame_{i + 1:05d}.png", view.color)
        write_image(folder / f"depths/frame_{i + 1:05d}.png", millimetres(view.depth))
        frames.append(
            {
                "file_path": f"./images/frame_{i + 1:05d}.png",
                "depth_file_path": f"depths/frame_{i + 1:05d}.png",
                "transform_matrix": (view.T_world_camera @ OPENGL).tolist(),
            }
        )
    c = CAMERA
    camera = {"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx + 0.5, "cy": c.cy + 0.5, "w": c.width, "h": c.height}
    identity = np.eye(4)[:3].tolist()
    data = {"camera_model": "OPENCV", **camera, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}
    # The order of the frames is that of the file names, whatever that of the list.
    data |= {"applied_transform": identity, "frames": frames[::-1]}
    (folder / "transforms.json").write_text(json.dumps(data))


def write_polycam(folder: Path, views: Sequence[View], kind: str = "corrected_") -> None:
    root, c = folder / "keyframes", OF_COLOR
    for view in views:
        name = f"{round(view.time * 1e6)}"
        write_jpeg(root / f"{kind}images/{name}.jpg", enlarged(view))
        write_image(root / f"depth/{name}.png", millimetres(view.depth))
        write_image(root / f"confidence/{name}.png", np.where(view.depth > 0, 255, 127).astype(np.uint8))
        T = view.T_world_camera @ OPENGL
        data = {"fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "width": c.width, "height": c.height}
        data |= {f"t_{i}{j}": T[i, j] for i in range(3) for j in range(4)}
        data |= {"blur_score": 90.1, "timestamp": int(name), "neighbors": []}
        (root / f"{kind}cameras").mkdir(exist_ok=True)
        (root / f"{kind}cameras/{name}.json").write_text(json.dumps(data))
    (folder / "mesh_info.json").write_text("{}")


def write_scannerapp(folder: Path, views: Sequence[View]) -> None:
    for i, view in enumerate(views):
        write_jpeg(folder / f"frame_{i:05d}.jpg", enlarged(view))
        write_image(folder / f"depth_{i:05d}.png", millimetres(view.depth))
        write_image(folder / f"conf_{i:05d}.png", np.where(view.depth > 0, 2, 0).astype(np.uint8))
        data = {
            "frame_index": i,
            "time": view.time,
            "intrinsics": OF_COLOR.K.ravel().tolist(),
            "cameraPoseARFrame": (view.T_world_camera @ OPENGL).ravel().tolist(),
            "motionQuality": 1,
        }
        (folder / f"frame_{i:05d}.json").write_text(json.dumps(data))
    (folder / "info.json").write_text('{"title": "scan"}')


def record3d_metadata(views: Sequence[View]) -> dict:
    c = OF_COLOR
    poses = []
    for view in views:
        T = view.T_world_camera @ OPENGL
        w, x, y, z = R_to_quat(T[:3, :3])
        poses.append([x, y, z, w, *T[:3, 3]])
    return {
        "w": c.width,
        "h": c.height,
        "dw": CAMERA.width,
        "dh": CAMERA.height,
        "fps": 10,
        "K": c.K.T.ravel().tolist(),
        "perFrameIntrinsicCoeffs": [[c.fx, c.fy, c.cx, c.cy]] * len(views),
        "frameTimestamps": [view.time for view in views],
        "poses": poses,
        "initPose": [0, 0, 0, 1, 0, 0, 0],
    }


def record3d_members(views: Sequence[View]) -> dict[str, bytes]:
    """Name in the archive -> content."""
    lzfse = pytest.importorskip("lzfse", reason="extra phone is not installed")
    members = {"metadata": json.dumps(record3d_metadata(views)).encode()}
    for i, view in enumerate(views):
        depth = np.where(view.depth > 0, view.depth, np.nan).astype("<f4")
        members[f"rgbd/{i}.jpg"] = jpeg(enlarged(view))
        members[f"rgbd/{i}.depth"] = lzfse.compress(depth.tobytes())
        members[f"rgbd/{i}.conf"] = lzfse.compress(np.where(view.depth > 0, 2, 0).astype(np.uint8).tobytes())
    return members


def write_record3d(folder: Path, views: Sequence[View]) -> None:
    write_zip(folder / "2024-05-01--10-00-00.r3d", record3d_members(views))


def write_zip(path: Path, members: dict[str, bytes]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def write_record3d_exr(folder: Path, views: Sequence[View]) -> None:
    exr = pytest.importorskip("OpenEXR", reason="extra phone is not installed")
    root = folder / "EXR_RGBD"
    (root / "depth").mkdir(parents=True)
    for i, view in enumerate(views):
        write_jpeg(root / f"rgb/{i}.jpg", enlarged(view))
        depth = np.where(view.depth > 0, view.depth, np.nan).astype(np.float32)
        with exr.File({"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}, {"R": depth}) as file:
            file.write(str(root / f"depth/{i}.exr"))
    (root / "metadata.json").write_text(json.dumps(record3d_metadata(views)))


ODOMETRY = "timestamp, frame, x, y, z, qx, qy, qz, qw, fx, fy, cx, cy, distortion_center_x, distortion_center_y"


def write_stray(folder: Path, views: Sequence[View], header: str = ODOMETRY, depth: str = "png") -> None:
    """As the app writes it: every field after a comma has a space before it, unknown fields are empty."""
    c = OF_COLOR
    write_video(folder / "rgb.mp4", [enlarged(view) for view in views])
    lines = [header]
    for i, view in enumerate(views):
        write_image(folder / f"confidence/{i:06d}.png", np.where(view.depth > 0, 2, 1).astype(np.uint8))
        raw = millimetres(view.depth)
        if depth == "png":
            write_image(folder / f"depth/{i:06d}.png", raw)
        else:
            (folder / "depth").mkdir(exist_ok=True)
            np.save(folder / f"depth/{i:06d}.npy", raw)
        T = view.T_world_camera
        w, x, y, z = R_to_quat(T[:3, :3])
        known = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), [*T[:3, 3], x, y, z, w], strict=True))
        known |= {"timestamp": view.time, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy}
        words = {key: f"{value:.9f}" for key, value in known.items()} | {"frame": f"{i:06d}"}
        lines.append(", ".join(words.get(key, "") for key in header.split(", ")))
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n")
    rows = [", ".join(f"{v:.6f}" for v in row) for row in c.K]
    (folder / "camera_matrix.csv").write_text("\n".join(rows))
    (folder / "imu.csv").write_text("timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n")


def write_video(path: Path, images: Sequence[np.ndarray]) -> None:
    """Lossless; the decoder goes by content, not by name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    work = path.with_suffix(".avi")
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(work), cv2.VideoWriter_fourcc(*"FFV1"), 30, (width, height))
    assert writer.isOpened()
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    work.rename(path)


def write_arkitscenes(folder: Path, views: Sequence[View]) -> None:
    c, lines = CAMERA, []
    for view in views:
        # Pose and camera carry times that differ by a millisecond, as they do in the dataset.
        name = f"41069021_{view.time - START_TIME + 3000:.3f}"
        write_image(folder / f"lowres_wide/{name}.png", view.color)
        write_image(folder / f"lowres_depth/{name}.png", millimetres(view.depth))
        write_image(folder / f"confidence/{name}.png", np.where(view.depth > 0, 2, 1).astype(np.uint8))
        (folder / "lowres_wide_intrinsics").mkdir(exist_ok=True)
        pincam = folder / f"lowres_wide_intrinsics/41069021_{view.time - START_TIME + 3000.001:.3f}.pincam"
        pincam.write_text(f"{c.width} {c.height} {c.fx} {c.fy} {c.cx} {c.cy}\n")
        T = invert_T(view.T_world_camera)
        numbers = [*Rotation.from_matrix(T[:3, :3]).as_rotvec(), *T[:3, 3]]
        lines.append(f"{view.time - START_TIME + 2999.999:.6f} " + " ".join(f"{v:.9f}" for v in numbers))
    (folder / "lowres_wide.traj").write_text("\n".join(lines) + "\n")


def write_realsense(folder: Path, views: Sequence[View]) -> None:
    write_bag(folder / "20240501_100000.bag", views)


WRITERS: dict[str, Callable[[Path, Sequence[View]], object]] = {
    "open3d": write_open3d,
    "tum": write_tum,
    "sevenscenes": write_sevenscenes,
    "replica": write_replica,
    "scannet": write_scannet,
    "bop": write_bop,
    "rtabmap": write_rtabmap,
    "pcd": write_pcd_folder,
    "plain": write_plain,
    "nerfstudio": write_nerfstudio,
    "polycam": write_polycam,
    "scannerapp": write_scannerapp,
    "record3d": write_record3d,
    "record3d_exr": write_record3d_exr,
    "stray": write_stray,
    "arkitscenes": write_arkitscenes,
    "realsense": write_realsense,
    "rosbag": lambda folder, views: write_ros(folder / "walk.mcap", views, storage="mcap_file"),
}
LOSSY = {"polycam": 4.0, "scannerapp": 4.0, "record3d": 4.0, "record3d_exr": 4.0}
"""Layouts whose colour is compressed with losses -> grey levels by which it may differ on average."""
WITHOUT_POSES = {"pcd", "plain", "realsense"}
