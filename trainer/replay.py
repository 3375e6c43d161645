"""One trial to look at: recorded once, then drawn as a video or written as an animated model."""

from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from realsim.core.errors import RealsimError
from realsim.core.files import explain_write_errors
from realsim.core.progress import track
from realsim.core.registry import Registry
from realsim.core.types import F64
from trainer.errors import TrainerError
from trainer.evaluate import Policy
from trainer.physics import PhysicsConfig
from trainer.physics.world import slots_for, world_spec
from trainer.robots import TrainedRobot
from trainer.tasks.parkour import ParkourEnv
from trainer.tasks.parkour.terminations import OUTCOMES
from trainer.terrain import Terrain

SUN = np.array([-0.8, -1.2, 4.0])
"""Metres from what is looked at to the light."""
START, GOAL = (0.75, 0.35, 0.3, 1.0), (0.3, 0.5, 0.75, 1.0)
"""Colours of the marks on the platforms, red and blue as in the paper."""
MARK_THICKNESS = 0.002
"""Metres."""
BELOW = 0.02
"""Metres by which the ground is drawn lower where a measured surface lies on it."""

FORMATS = Registry(
    "replay format",
    {
        ".mp4": "trainer.replay:video",
        ".gif": "trainer.replay:video",
        ".webp": "trainer.replay:video",
        ".glb": "trainer.replay_glb:glb",
    },
)
"""File ending -> `(recording, robot, terrain, path) -> Path`."""


@dataclass(frozen=True)
class Recording:
    """A trial; T policy steps."""

    qpos: F64
    """(T, 7 + J) base position (m, terrain frame), base quaternion (w x y z), joints (rad)."""
    dt: float
    """Seconds between rows."""
    outcome: str
    """Its outcome: a name of `terminations.OUTCOMES`."""


@torch.inference_mode()
def record(policy: Policy, env: ParkourEnv, world: int = 0) -> Recording:
    """The next episode of one world, from its start to its end."""
    observation = env.reset()
    rows = [_pose(env, world)]
    for _ in track(count(), "simulating"):
        observation = env.step(policy(observation)).observation
        ended = [] if env.ends is None else env.ends.ids.tolist()
        if world in ended:
            assert env.ends is not None
            outcome = OUTCOMES[int(env.ends.outcome[ended.index(world)])]
            return Recording(np.array(rows), env.policy_dt, outcome)
        rows.append(_pose(env, world))
    raise AssertionError("counting has no end")


def _pose(env: ParkourEnv, world: int) -> F64:
    s = env.physics.state
    return torch.cat([s.base_pos[world], s.base_quat[world], s.joint_pos[world]]).double().cpu().numpy()


def write(recording: Recording, robot: TrainedRobot, terrain: Terrain, path: str | Path) -> Path:
    """The trial as a file of the kind that its name's ending asks for: one of `FORMATS`.

    Raises:
        UnknownNameError: another ending.
    """
    return FORMATS[Path(path).suffix](recording, robot, terrain, path)


def video(
    recording: Recording,
    robot: TrainedRobot,
    terrain: Terrain,
    path: str | Path,
    *,
    size: tuple[int, int] | None = None,
    fps: float | None = None,
    distance: float = 2.8,
) -> Path:
    """The trial from the side, the camera following, as .gif or .webp if the name ends so, else as .mp4.

    Args:
        size: (width, height) pixels; 640 x 360, or 360 x 202 of a picture that moves (.gif, .webp).
        fps: frames per second of the trial; 25, or 12.5 of a picture that moves.
        distance: metres from the camera to the robot.

    Raises:
        TrainerError: no way to render on this machine.
    """
    path = Path(path)
    picture = path.suffix in (".gif", ".webp")
    size = size or ((360, 202) if picture else (640, 360))
    fps = fps or (12.5 if picture else 25.0)
    frames = _frames(recording, robot, terrain, size, fps, distance)
    with explain_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        (write_animation if picture else _write_mp4)(frames, path, fps)
    return path


def _frames(
    recording: Recording, robot: TrainedRobot, terrain: Terrain, size: tuple[int, int], fps: float, distance: float
) -> list[NDArray[np.uint8]]:
    import mujoco

    model = scene_model(robot, terrain, size)
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = distance, 120.0, -18.0
    every = max(1, round(1 / (fps * recording.dt)))
    try:
        renderer = mujoco.Renderer(model, height=size[1], width=size[0])
    except Exception as error:  # whatever the OpenGL loader of this machine raises
        raise TrainerError(
            "this machine cannot render",
            found=str(error),
            hint="without a display set MUJOCO_GL=egl (GPU) or MUJOCO_GL=osmesa (CPU)",
        ) from error
    frames = []
    look = recording.qpos[0, :3].copy()
    for qpos in track(recording.qpos[::every], "rendering"):
        look += 0.2 * (qpos[:3] - look)  # a calm camera
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        camera.lookat[:] = look
        data.light_xpos[0] = look + SUN  # the light goes along: a shadow is only as sharp as its map is small
        renderer.update_scene(data, camera)
        frames.append(renderer.render().copy())
    renderer.close()
    return frames


def scene_model(robot: TrainedRobot, terrain: Terrain, size: tuple[int, int]) -> Any:
    """The simulated world as a model that can be drawn: light, sky, chequered ground, the robot's collision shapes.

    Of a reconstructed scene the measured surface is drawn in its colours, not what stands for it in contacts.
    """
    import mujoco

    spec = world_spec(robot, terrain, slots_for([terrain]), PhysicsConfig())
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.map.znear = 0.01
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.85, 0.9, 0.95], rgb2=[0.55, 0.65, 0.75], width=64, height=64,
    )  # fmt: skip
    spec.add_texture(
        name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.32, 0.35, 0.38], rgb2=[0.38, 0.41, 0.44], width=256, height=256,
    )  # fmt: skip
    tiles = spec.add_material(name="tiles", texrepeat=[2, 2], texuniform=True)
    textures = list(tiles.textures)
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    tiles.textures = textures
    for geom in spec.worldbody.geoms:
        geom.group = 0  # a scene's collision geometry is in a group that MuJoCo does not draw by default
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.material, geom.rgba = "tiles", [1, 1, 1, 1]
            geom.pos = geom.pos - np.array([0, 0, BELOW if terrain.drawn else 0.0])
        else:
            geom.rgba = [0.72, 0.6, 0.45, 0 if terrain.drawn else 1]
    if terrain.drawn is not None:
        _draw_surface(spec, terrain.drawn)
    for platform, colour in ((terrain.start, START), (terrain.goal, GOAL)):
        half = [*(platform.size / 2), MARK_THICKNESS]
        turn = [np.cos(platform.yaw / 2), 0, 0, np.sin(platform.yaw / 2)]
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=platform.centre, quat=turn, rgba=colour,
            contype=0, conaffinity=0,
        )  # fmt: skip
    spec.worldbody.add_light(pos=SUN, dir=-SUN, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    return spec.compile()


def _draw_surface(spec: Any, file: Path) -> None:
    """A mesh that collides with nothing, with the texture that lies beside it."""
    import mujoco

    spec.add_mesh(name="surface", file=str(file.resolve()), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    material = spec.add_material(name="surface", specular=0, shininess=0)
    picture = file.with_suffix(".png")
    if picture.is_file():
        spec.add_texture(name="surface", type=mujoco.mjtTexture.mjTEXTURE_2D, file=str(picture.resolve()))
        textures = list(material.textures)
        textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "surface"
        material.textures = textures
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="surface", material="surface", contype=0, conaffinity=0
    )


def _write_mp4(frames: list[NDArray[np.uint8]], path: Path, fps: float) -> None:
    import cv2

    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (width, height))
    if not writer.isOpened():
        raise RealsimError("OpenCV cannot write this video", file=path, hint="write a .gif instead")
    for frame in frames:
        writer.write(frame[..., ::-1])
    writer.release()


def write_animation(frames: list[NDArray[np.uint8]], path: Path, fps: float) -> None:
    """(H, W, 3) RGB frames of one size as an endless animation: .webp, which is a quarter as large, or .gif."""
    from PIL import Image

    endless: dict[str, Any] = {"save_all": True, "duration": round(1000 / fps), "loop": 0}
    if path.suffix == ".webp":
        first, *others = map(Image.fromarray, frames)
        first.save(path, append_images=others, quality=75, **endless)
        return
    # One palette for all and no dithering: what does not move is then the same in every frame, and costs nothing.
    palette = Image.fromarray(np.vstack([frames[0], frames[-1]])).quantize(64)
    images = [Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    images[0].save(path, append_images=images[1:], **endless)
