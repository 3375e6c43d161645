"""report.html of a reconstruction, from top to bottom."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from realsim.core.types import U8, Reconstruction
from realsim.report import page, raster, svg, viewer3d
from realsim.report.contact import contact_card
from realsim.report.layers import scene_view
from realsim.report.marks import marks_of
from realsim.report.modes import modes_card
from realsim.report.summary import Made, versions
from realsim.report.topdown import map_from_above
from realsim.report.verdict import Judgement, dropped_frames, millimetres, percent, scale_of

_THUMBNAILS = 24
_RESIDUAL_RANGE = 0.02  # metres
_LISTED = 6  # dropped frames that are not folded


def reconstruction_page(
    folder: Path,
    result: Reconstruction,
    judgement: Judgement,
    made: Made,
    picture: Callable[[], U8 | str] | None = None,
) -> str:
    """The whole page.

    Args:
        folder: holds the exported scene.
        made: when and how the scene was made.
        picture: waits for (H, W, 3) RGB as MuJoCo draws the scene, or why it could not; None leaves the picture out.
    """
    metric = result.aligned.metric
    backend = metric.backend if metric is not None else "scan"
    views = f"{len(metric)} views" if metric is not None else "a scan"
    drag = "Drag to turn, two fingers or the right button to move, pinch or wheel to zoom."
    marks, unseen = marks_of(result, judgement), any(c.shown == "unseen" for c in judgement.failed)
    view = scene_view(folder, result, marks, unseen=unseen)
    # What is not to be used does not begin with how it is used.
    first, second = [use_card(folder)], [_checks_card(judgement)]
    notes = [_notes_card(result), *_scale_card(result), _platform_card(result), _dropped_card(result)]
    if judgement.level == "bad":
        first, second = second, first
    # Beside the checks, which are as long as all notes, or below the short card of commands.
    (second if judgement.level == "bad" else notes).extend(contact_card(result))
    below = [
        page.grid(
            page.card("The scene and its collision geometry (orange)", view, drag, wide=True),
            page.card("From above", map_from_above(result.aligned, result.mesh, marks, unseen=unseen), wide=True),
        ),
        page.grid(*_changes_card(result)),
        page.columns(second, notes),
        page.grid(*modes_card(result), *_residual_card(result), *_thumbnail_card(result)),
        page.columns([_run_card(result, made)], [_mesh_card(result), _versions_card(result)]),
    ]
    body = [
        page.verdict(judgement.level, judgement.headline, judgement.reasons, judgement.next_steps),
        page.facts(_facts(result)),
        page.columns(_picture_card(picture()), first) if picture is not None else page.grid(*first),
        *below,
    ]
    title = f"Reconstruction of {'/'.join(result.source.source.parts[-2:])}"
    subtitle = f"{views}, layout {result.source.layout}, backend {backend}, surface {result.mesh.method}"
    return page.document(title, subtitle, "".join(body), scripts=[viewer3d.script()])


def _picture_card(picture: U8 | str) -> list[str]:
    if isinstance(picture, str):
        return [page.card("In MuJoCo", page.bullets([], f"No picture: {picture}"))]
    uri = raster.photo_uri(picture, picture.shape[1], quality=82)
    body = f'<img class="picture" src="{uri}" alt="the scene as MuJoCo draws it">'
    return [page.card("In MuJoCo", body, "scene.xml as MuJoCo draws it. Surfaces that no camera saw are left open.")]


def _facts(result: Reconstruction) -> list[tuple[str, str, str]]:
    aligned, mesh = result.aligned, result.mesh
    out = []
    scale = scale_of(result)
    if scale is not None:
        half = (scale.ci90[1] - scale.ci90[0]) / 2
        out.append(("Scale", f"{scale.value:.4f}", f"± {half:.4f} (90 %), {scale.method}"))
    out.append(("Level", f"± {aligned.gravity.tilt_sigma_deg:.2g}°", "standard error of the tilt"))
    if aligned.metric is not None:
        dropped = len(dropped_frames(result))
        out.append(("Frames", f"{len(aligned.metric)} used", f"{dropped} dropped"))
        gain = aligned.metric.depth_gain
        if gain != 1:
            out.append(("Depth sensor", f"{100 * (1 / gain - 1):+.2f} %", "its scale error, found and corrected"))
    start, goal = aligned.platform("start"), aligned.platform("goal")
    if start is not None and goal is not None:
        away = float(np.linalg.norm((goal.centroid - start.centroid)[:2]))
        out.append(("Start to goal", f"{away:.3f} m", "between the tops' centroids"))
    if mesh.residuals:
        typical = float(np.median([r.median_abs_m for r in mesh.residuals]))
        out.append(("Depth to mesh", millimetres(typical), "median distance"))
    out.append(("Mesh", f"{mesh.quality.triangles:,}".replace(",", " "), "triangles"))
    return out


def _scale_card(result: Reconstruction) -> list[str]:
    scale = scale_of(result)
    if scale is None or len(scale.per_frame) < 2:
        return []
    y = np.asarray(scale.per_frame, float)
    if not np.isfinite(y).all():  # a tag or sheet that only some frames see
        return []
    if np.ptp(y) < 1e-6:  # points that come from the depth itself have one scale: a flat line says nothing
        return []
    span = svg.padded(np.r_[y, scale.ci90, scale.value])
    wide = max(span[1] - scale.value, scale.value - span[0], 0.01 * scale.value)
    axes = svg.Axes(
        (-0.5, len(y) - 0.5), (scale.value - wide, scale.value + wide), x_label="frame", y_label="metres per unit"
    )
    axes.span(*scale.ci90).rule(scale.value, text=f"{scale.value:.4f}")
    assert result.aligned.metric is not None
    names = [f"{f.name}: {v:.4f}" for f, v in zip(result.aligned.metric.frames, y, strict=True)]
    axes.dots(np.column_stack([np.arange(len(y)), y]), titles=names)
    spread = percent(scale.per_frame_spread)
    note = f"One ratio per frame; the stripe is the 90 % interval. Spread between frames {spread}."
    return [page.card("Scale, frame by frame", axes.svg("scale of every frame"), note)]


def _changes_card(result: Reconstruction) -> list[str]:
    if result.changes is None:
        return []
    rows = [[change["kind"], change["text"]] for change in result.changes["objects"]]
    note = f"Against {result.changes['since']}, over {result.changes['compared_m2']:.1f} m² that both scans saw."
    body = page.table(["change", "what"], rows) if rows else "<p>Nothing of 3 cm or more is otherwise.</p>"
    return [page.card("Since the earlier scene", body, note, wide=True)]


def _checks_card(judgement: Judgement) -> str:
    rows = [
        [page.badge(c.level), f"{page.esc(c.name)}<small>{page.esc(c.limits)}</small>", c.found]
        for c in judgement.checks
    ]
    body = page.table(["", "check and its rule", "found"], rows, raw=[0, 1])
    return page.card("What the verdict rests on", body, "The worst of these is the verdict.")


def _residual_card(result: Reconstruction) -> list[str]:
    items = []
    for r in result.mesh.residuals:
        picture = raster.colorize(r.image, -_RESIDUAL_RANGE, _RESIDUAL_RANGE, raster.SIGNED)
        step = max(1, round(picture.shape[1] / 200))
        items.append(
            (raster.photo_uri(picture[::step, ::step], 200), f"{r.name}: {millimetres(r.median_abs_m)}", "median")
        )
    if not items:
        return []
    body = page.thumbnails(items) + svg.color_bar(-1e3 * _RESIDUAL_RANGE, 1e3 * _RESIDUAL_RANGE, "mm", raster.SIGNED)
    note = "Measured depth minus the mesh along each ray: red lies behind the mesh, blue in front, empty has no depth."
    return [page.card("Where depth and mesh disagree", body, note, wide=True)]


def _thumbnail_card(result: Reconstruction) -> list[str]:
    metric = result.aligned.metric
    if metric is None:
        return []
    pick = np.unique(np.linspace(0, len(metric) - 1, min(_THUMBNAILS, len(metric))).round().astype(int))
    items = []
    for i in pick:
        color = metric.frames[i].color()
        if color is not None:
            x, y, z = result.aligned.T_sim_camera(int(i))[:3, 3]
            items.append((raster.photo_uri(color, 200), metric.frames[i].name, f"camera at {x:.2f} {y:.2f} {z:.2f} m"))
    return (
        [page.card("What the camera saw", page.thumbnails(items), f"{len(items)} of {len(metric)} views.", wide=True)]
        if items
        else []
    )


def _notes_card(result: Reconstruction) -> str:
    assumed = [*result.aligned.assumptions, *result.source.assumptions]  # axes first: the verdict points at them
    parts = [
        "<h4>Warnings</h4>",
        page.bullets(result.warnings),
        "<h4>Assumed</h4>",
        page.folded_bullets(assumed, "more"),
    ]
    parts += ["<h4>Cut away</h4>", page.folded_bullets(result.aligned.cropped, "more")]
    return page.card("Warnings and assumptions", "".join(parts))


def _platform_card(result: Reconstruction) -> str:
    def numbers(values: np.ndarray) -> str:
        # Adding zero turns -0.000 into 0.000.
        return "  ".join(f"{v:.3f}" for v in np.round(values, 3) + 0.0)

    rows = [
        [p.role, numbers(p.centroid), numbers(p.size), f"{np.degrees(p.yaw):.1f}°"] for p in result.aligned.platforms
    ]
    rows += [["ground", f"z = {result.aligned.ground_z:.3f}", "", ""]]
    body = page.table(["", "centroid x y z (m)", "length width height (m)", "yaw"], rows)
    note = (
        "Origin at the centroid of the start platform's top, z up, x toward the goal. Wrong ones? Run again with "
        "--start X Y --goal X Y --overwrite."
    )
    return page.card("Platforms", body, note)


def _dropped_card(result: Reconstruction) -> str:
    rows = [list(row) for row in dropped_frames(result)]
    if not rows:
        return page.card("Dropped frames", page.bullets([], "Every frame was used."))
    head = ["frame", "stage", "why"]
    rest = rows[_LISTED:]
    more = page.fold(f"{len(rest)} more", page.table(head, rest)) if rest else ""
    return page.card(f"Dropped frames ({len(rows)})", page.table(head, rows[:_LISTED]) + more)


def _mesh_card(result: Reconstruction) -> str:
    mesh, q = result.mesh, result.mesh.quality
    closed = "yes" if q.watertight else "no: open at its border, as intended (contact has geometry of its own)"
    rows = [
        ["triangles", str(q.triangles)],
        ["resolution", millimetres(mesh.resolution)],
        ["invented triangles", str(int(mesh.invented.sum()))],
        ["closed", closed],
        ["manifold", _plain(q.manifold)],
        ["self-intersections", str(q.self_intersections)],
        ["degenerate triangles", str(q.degenerate)],
        ["pieces", str(q.components)],
    ]
    if q.volume_m3 is not None:
        rows.append(["volume", f"{q.volume_m3:.3f} m³"])
    if mesh.noise_m is not None:
        rows.append(["noise of the points", millimetres(mesh.noise_m)])
    contact = [
        [k.replace("_", " "), _plain(v)] for k, v in result.scene.contact.items() if not isinstance(v, (dict, list))
    ]
    body = page.table(["mesh", ""], rows) + page.fold("All contact figures", page.table(["contact", ""], contact))
    return page.folded("Mesh and contact in figures", body)


def _plain(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return svg.number(value, 4) if isinstance(value, float) else "–" if value is None else str(value)


def _run_card(result: Reconstruction, made: Made) -> str:
    parts = [(s.name + (" (kept)" if s.reused else ""), round(s.seconds, 2)) for s in result.stages]
    total, peak = sum(s.seconds for s in result.stages), max((s.peak_mb for s in result.stages), default=0.0)
    note = f"{made.date}; {total:.1f} s, at most {peak:.0f} MB of memory. Stages marked (kept) came from the cache."
    return page.card("This run", page.code(made.command) + svg.stacked(parts, unit="s"), note)


_FILES = {
    "scene.xml": "the MuJoCo model: open this",
    "robot.xml": "the robot, included by scene.xml",
    "mesh.ply": "the surface as triangles",
    "mesh.glb": "the same for viewers and Blender",
    "report.json": "all figures of this page",
    "contact.json": "all figures of this page",
}


def use_card(folder: Path) -> str:
    """Commands and lines to copy, and the files that lie beside the page."""
    shell = "python -m mujoco.viewer --mjcf=scene.xml\nrealsim view .\nrealsim export . --to usd,urdf"
    python = 'import mujoco\n\nmodel = mujoco.MjModel.from_xml_path("scene.xml")'
    files = [(name, what) for name, what in _FILES.items() if (folder / name).is_file()]
    note = "Metres, z up. Run these in the scene's folder."
    return page.card("Use the scene", page.code(shell) + page.code(python) + page.links(files), note)


def _versions_card(result: Reconstruction) -> str:
    rows = [[name, value] for name, value in versions().items()] + [["seed", str(result.seed)]]
    return page.folded("Made with", page.table(["package", "version"], rows))
