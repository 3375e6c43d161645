"""A rendered capture, rewritten as a phone app stores one: 3D Scanner App, export "All Data".

    realsim synth --terrain mixed --frames 40 --with-poses --out synthetic
    python examples/05_phone_capture.py synthetic phone

Depth on a grid of 256 x 192 as a phone's LiDAR gives it, and camera poses in ARKit's axes, in a world whose y is up.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

synthetic, phone = Path(sys.argv[1]), Path(sys.argv[2])
phone.mkdir(parents=True)
truth = json.loads((synthetic / "truth" / "truth.json").read_text())
camera = truth["cameras"]["color"]
intrinsics = [camera["fx"], 0, camera["cx"], 0, camera["fy"], camera["cy"], 0, 0, 1]
up_is_y = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])  # from a world whose z is up
opengl = np.diag([1.0, -1.0, -1.0, 1.0])  # ARKit's camera looks along -z, its y is up
for i, T_sim_camera in enumerate(truth["T_sim_camera"]):
    color = cv2.imread(str(synthetic / "capture" / "color" / f"{i:06d}.jpg"))
    depth = cv2.imread(str(synthetic / "capture" / "depth" / f"{i:06d}.png"), cv2.IMREAD_UNCHANGED)
    depth = cv2.resize(depth, (256, 192), interpolation=cv2.INTER_NEAREST)
    cv2.imwrite(str(phone / f"frame_{i:05d}.jpg"), color, [cv2.IMWRITE_JPEG_QUALITY, 95])
    cv2.imwrite(str(phone / f"depth_{i:05d}.png"), depth)
    cv2.imwrite(str(phone / f"conf_{i:05d}.png"), np.where(depth > 0, 2, 0).astype(np.uint8))
    pose = up_is_y @ np.array(T_sim_camera) @ opengl
    frame = {"frame_index": i, "time": i / 10, "intrinsics": intrinsics, "cameraPoseARFrame": pose.ravel().tolist()}
    (phone / f"frame_{i:05d}.json").write_text(json.dumps(frame))
print(f"{len(truth['T_sim_camera'])} frames in {phone}")
