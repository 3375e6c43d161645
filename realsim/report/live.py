"""A live viewer of a scene folder in the browser (viser), with a switch for each layer."""

import contextlib
import errno
import io
import socket
import time
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import MissingExtraError, RealsimError
from realsim.core.files import check_size, read_json
from realsim.core.geometry import R_to_quat
from realsim.report.collision import collision_triangles, load, robot_triangles
from realsim.report.layers import CAMERAS, COLLISION, PLATFORMS, ROBOT
from realsim.report.picture import standpoint


def view(folder: Path, port: int = 8080, *, wait: bool = True) -> Any:
    """Serve a scene on this machine until interrupted.

    Args:
        folder: that `realsim reconstruct` or `realsim contact` wrote; the latter has no cameras and no platforms.
        port: where the page is served (http://localhost:PORT); the next free one if it is taken.
        wait: False returns the running server at once; `server.stop()` ends it.

    Returns:
        The viser server if not `wait`, else None.

    Raises:
        MissingExtraError: viser is not installed.
        RealsimError: no scene in the folder, or a port that cannot be used.
    """
    check_port(port, taken=True)
    # `realsim contact` writes contact.json, which has no cameras and no platforms.
    names = ("report.json", "contact.json")
    figures = next((name for name in names if (folder / name).is_file()), names[0])
    for name in ("scene.xml", "mesh.ply", "mesh.glb", figures):
        if not (folder / name).is_file():
            hint = "give a folder made by `realsim reconstruct` or `realsim contact`"
            raise RealsimError("no scene here", file=folder / name, hint=hint)
        check_size(folder / name)
    try:
        import viser
    except ImportError as error:
        raise MissingExtraError("viser", "viewer", "the live viewer") from error
    report = read_json(folder / figures)
    with contextlib.redirect_stdout(io.StringIO()):  # viser prints a table of its own, whatever `verbose` says
        server = viser.ViserServer(
            host="127.0.0.1", port=port, label=f"realsim: {folder.absolute().name}", verbose=False
        )
    model, data = load(folder / "scene.xml")
    # The button would pass the scene through a public relay.
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.scene.set_up_direction("+z")
    server.scene.world_axes.visible = True
    _light(server)
    # The first camera shows the terrain from the side on which it was seen, as scene.xml says.
    target, distance, azimuth, elevation = standpoint(model, data, np.degrees(server.initial_camera.fov), 1.0)
    a, e = np.radians([azimuth, elevation])
    ahead = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    server.initial_camera.look_at = target
    server.initial_camera.position = target - distance * ahead
    _switch(server, "mesh", _mesh(server, folder / "mesh.glb"))
    _switch(server, "cloud", _cloud(server, folder / "mesh.ply"), on=False)
    _switch(server, "collision", _collision(server, folder / "scene.xml"))
    _switch(server, "robot", _robot(server, model, data))
    _switch(server, "frames", _frames(server, report))
    _switch(server, "platforms", _platforms(server, report))
    if not wait:
        return server
    print(f"open http://localhost:{server.get_port()} in a browser; Ctrl-C ends the viewer", flush=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        server.stop()
    return None


def check_port(port: int, *, taken: bool = False) -> int:
    """The port of this machine, a free one for 0.

    Args:
        taken: whether somebody may listen there already.

    Raises:
        RealsimError: nothing can be served there.
    """
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a server that has just ended is none
            probe.bind(("127.0.0.1", port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        if taken and getattr(error, "errno", None) == errno.EADDRINUSE:
            return port
        raise RealsimError(
            "the page cannot be served at this port", expected="a free port of 1024 to 65535",
            found=f"--port {port}: {getattr(error, 'strerror', None) or error}", hint="give another --port",
        ) from error  # fmt: skip


def _light(server: Any) -> None:
    """Mostly even light: the surface already has the light of the room in its colours."""
    server.scene.configure_default_lights(enabled=False)
    server.scene.configure_environment_map(hdri=None)
    server.scene.add_light_ambient("/light/all", intensity=2.4)
    server.scene.add_light_directional("/light/sun", intensity=1.0, position=(3.0, -4.0, 8.0))


def _switch(server: Any, name: str, handles: list[Any], *, on: bool = True) -> None:
    """A checkbox that shows and hides the handles; without any, it is there and cannot be used."""
    box = server.gui.add_checkbox(name, on and bool(handles), disabled=not handles)

    def update(_: Any = None) -> None:
        for handle in handles:
            handle.visible = box.value

    box.on_update(update)
    update()


def _load(path: Path) -> Any:
    import trimesh

    mesh: Any = trimesh.load(path, process=False, force="mesh")
    return mesh


def _mesh(server: Any, path: Path) -> list[Any]:
    # The glTF file says that the surface is matt; its y is up.
    half = np.sqrt(0.5)
    return [server.scene.add_glb("/mesh", path.read_bytes(), wxyz=(half, half, 0.0, 0.0))]


def _cloud(server: Any, path: Path) -> list[Any]:
    """The vertices of the surface as points in their colours."""
    mesh = _load(path)
    points = np.asarray(mesh.vertices, np.float32)
    colors = np.asarray(mesh.visual.vertex_colors)[:, :3] if mesh.visual.kind == "vertex" else (120, 130, 150)
    return [server.scene.add_point_cloud("/cloud", points, colors, point_size=0.006)]


def _collision(server: Any, path: Path) -> list[Any]:
    V, F = collision_triangles(path)
    if not len(F):
        return []
    return [server.scene.add_mesh_simple("/collision", V, F, color=COLLISION, opacity=0.4, flat_shading=True)]


def _robot(server: Any, model: Any, data: Any) -> list[Any]:
    V, F = robot_triangles(model, data)
    return [server.scene.add_mesh_simple("/robot", V, F, color=ROBOT, flat_shading=False)] if len(F) else []


def _frames(server: Any, report: dict[str, Any]) -> list[Any]:
    """A pyramid for every camera, named after its frame."""
    handles = []
    for name, T in (report.get("cameras") or {}).items():
        T = np.asarray(T, float)
        handles.append(
            server.scene.add_camera_frustum(
                f"/frames/{name}",
                fov=0.75,
                aspect=4 / 3,
                scale=0.08,
                line_width=1.0,
                color=CAMERAS,
                wxyz=R_to_quat(T[:3, :3]),
                position=T[:3, 3],
            )
        )
    return handles


def _platforms(server: Any, report: dict[str, Any]) -> list[Any]:
    """The rectangle of every platform's top, and its role."""
    handles = []
    for i, p in enumerate(report.get("platforms", ())):
        centre, (length, width, _) = np.asarray(p["centroid"], float), p["size"]
        c, s = np.cos(p["yaw"]), np.sin(p["yaw"])
        ring = 0.5 * np.array(
            [[-length, -width], [length, -width], [length, width], [-length, width], [-length, -width]]
        )
        ring = ring @ np.array([[c, s], [-s, c]]) + centre[:2]
        points = np.column_stack([ring, np.full(5, centre[2] + 0.005)])
        segments = np.stack([points[:-1], points[1:]], axis=1)
        handles.append(server.scene.add_line_segments(f"/platforms/{i}", segments, PLATFORMS, line_width=3))
        handles.append(
            server.scene.add_label(f"/platforms/{i}/role", p["role"], position=centre + np.array([0, 0, 0.05]))
        )
    return handles
