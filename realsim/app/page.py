"""The page: open something, see what it is, start a command, watch it, look at the result."""

import asyncio
import shlex
import time
from collections.abc import Callable
from datetime import datetime
from html import escape
from pathlib import Path
from typing import Any

from realsim.app.actions import ACTIONS, FORMATS, WAYS, Action, arguments_of, free_folder
from realsim.app.gallery import Result, results_below
from realsim.app.preview import Preview, preview
from realsim.app.work import Work
from realsim.cli.roots import Roots
from realsim.core.errors import RealsimError
from realsim.core.recognise import KINDS, Kind, recognise

UPLOADS = "dropped"
"""Folder for files that are dropped on the page."""
MOST_UPLOADED = 2_000_000_000
COLORS = {"good": "positive", "look": "warning", "bad": "negative", "identified": "positive", "no_gap": "positive"}
STATES = {"waiting": "grey", "running": "primary", "done": "positive", "failed": "negative", "cancelled": "grey"}


class Desk:
    """What the page knows, for as long as it is served: one person, one folder, one command at a time."""

    def __init__(self, roots: Roots) -> None:
        self.roots = roots
        self.opened: Path | None = None
        self.kind: Kind | None = None
        self.known = True
        """Whether the files of what was opened are of a known kind; else `kind` is a guess."""
        self.look: Work | None = None
        self.preview = Preview()
        self.works: list[Work] = []
        self.reading: Result | None = None
        """The result whose report is shown."""
        self._free = asyncio.Semaphore(1)
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def root(self) -> Path:
        return self.roots.folders[0]

    @property
    def ways(self) -> tuple[str, ...]:
        """The actions that fit what was opened: none where it is of no known kind, and its command refused it."""
        if self.kind is None or (not self.known and self.look is not None and self.look.state == "failed"):
            return ()
        return WAYS.get(self.kind.name, ((), ()))[1]

    async def open(self, text: str) -> None:
        """Recognise what is at a path: by its files, then by the command that reads it, then by pictures.

        What was being looked at before is given up.

        Raises:
            RealsimError: no such path below the folder.
        """
        path = self.roots.source(text)
        before, self.look = self.look, None
        if before is not None:
            await before.cancel()
        # An input of no known kind is read as a capture, whose reader says what is missing.
        self.opened, self.preview = path, Preview()
        recognised = recognise(path)
        self.known = recognised is not None
        kind = self.kind = recognised or KINDS["capture"]
        command, _ = WAYS.get(kind.name, ((), ()))
        if not command:
            return
        look = self.look = Work("look", (*command, str(path)))
        await look.run()
        if look.state == "done" and kind.name in ("capture", "mesh", "scan"):
            found = await asyncio.to_thread(preview, path)
            if self.look is look:
                self.preview = found

    def start(self, title: str, arguments: tuple[str, ...], out: Path | None) -> Work:
        """Queue a command; it runs when those before it have ended."""
        work = Work(title, arguments, out)
        self.works.insert(0, work)
        task = asyncio.create_task(self._run(work))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return work

    async def _run(self, work: Work) -> None:
        async with self._free:
            if work.state == "waiting":
                await work.run()

    async def cancel(self, work: Work) -> None:
        """End a command, or take it from the queue."""
        if work.state == "waiting":
            work.state = "cancelled"
        else:
            await work.cancel()

    async def close(self) -> None:
        """End whatever runs."""
        for work in self.works:
            await self.cancel(work)


def show(desk: Desk) -> None:
    """Build the page for one visitor."""
    from nicegui import ui

    ui.add_css("pre{white-space:pre-wrap;overflow-wrap:anywhere;font-size:12px;margin:0} .q-card{box-shadow:none}")
    ui.add_css(".q-notification__message{white-space:pre-line;overflow-wrap:anywhere}")  # an error has lines
    with ui.column().classes("w-full max-w-5xl mx-auto gap-4 p-2"):
        ui.label("realsim").classes("text-2xl font-bold").props('role="heading" aria-level="1"')
        ui.label(f"Folder: {desk.root}").classes("text-sm opacity-70 break-all")
        refresh: list[Callable[[], Any]] = []

        def refreshed() -> None:
            for each in refresh:
                each()

        _opening(desk, refreshed)
        for section in (_recognised, _running, _report, _results):
            part = ui.refreshable(section)
            part(desk, refreshed)
            refresh.append(part.refresh)
        shown: dict[str, Any] = {}

        def tick() -> None:
            """Redraw what changed: a button that is redrawn loses the keyboard's focus, and the press of a mouse."""
            now = [w.state for w in desk.works]
            if now != shown.get("works"):
                ended = [w.ended for w in desk.works]
                refresh[1]()
                if ended != shown.get("ended"):
                    refresh[3]()
                shown.update(works=now, ended=ended)

        ui.timer(0.5, tick)


def _opening(desk: Desk, refreshed: Callable[[], None]) -> None:
    from nicegui import events, ui

    complaints: list[Any] = []

    async def opened(text: str) -> None:
        while complaints:  # of what was opened before: it would lie over the page
            complaints.pop().dismiss()
        note = ui.notification("looking", spinner=True, timeout=None)
        try:
            await desk.open(text or ".")
        except RealsimError as error:
            complaints.append(_complain(error))
        finally:
            note.dismiss()
        refreshed()

    async def dropped(event: events.UploadEventArguments) -> None:
        name = Path(event.file.name).name
        target = desk.root / UPLOADS / name
        if name in ("", ".", "..") or target.exists():
            _complain(RealsimError("a file of this name was dropped before", file=target, hint="rename it, or open it"))
            return
        target.parent.mkdir(exist_ok=True)
        await event.file.save(target)
        await opened(str(target))

    with ui.card().classes("w-full"):
        _title("What do you have?")
        ui.label("A folder of frames, a scan or mesh, a robot's recording or case, a finished scene or diagnosis.")
        with ui.row().classes("w-full items-center no-wrap"):
            path = ui.input("path below the folder").classes("grow").props("autofocus outlined dense")
            path.on("keydown.enter", lambda: opened(path.value))
            ui.button("Open", on_click=lambda: opened(path.value))
        with ui.row().classes("w-full items-center"):
            ui.button("Choose", icon="folder_open", on_click=lambda: _chooser(desk, path, opened)).props("outline")
            ui.upload(label="or drop a file", auto_upload=True, on_upload=dropped, max_file_size=MOST_UPLOADED).props(
                "flat bordered"
            ).classes("grow")


def _chooser(desk: Desk, path: Any, opened: Callable[[str], Any]) -> None:
    """A dialog that walks the folder, by mouse or keyboard."""
    from nicegui import ui

    with ui.dialog() as dialog, ui.card().classes("w-full"):

        @ui.refreshable
        def listing(folder: Path) -> None:
            ui.label(str(folder)).classes("text-sm break-all")
            with ui.row():
                if folder != desk.root:
                    ui.button("Up", icon="arrow_upward", on_click=lambda: listing.refresh(folder.parent)).props(
                        "flat dense"
                    )
                ui.button("Take this folder", on_click=lambda: take(folder)).props("dense")
            with ui.scroll_area().classes("w-full h-80"):
                for entry in sorted(folder.iterdir(), key=lambda p: (p.is_file(), p.name.lower())):
                    if entry.name.startswith(".") or entry.is_symlink():
                        continue
                    inside = entry.is_dir()
                    go = (lambda e=entry: listing.refresh(e)) if inside else (lambda e=entry: take(e))
                    icon = "folder" if inside else "description"
                    ui.button(entry.name, icon=icon, on_click=go).props("flat dense no-caps align=left").classes(
                        "w-full"
                    )

        async def take(chosen: Path) -> None:
            dialog.close()
            path.value = str(chosen.relative_to(desk.root)) if chosen != desk.root else "."
            await opened(path.value)

        listing(desk.root)
    dialog.open()


def _recognised(desk: Desk, refreshed: Callable[[], None]) -> None:
    from nicegui import ui

    if desk.opened is None or desk.kind is None:
        return
    with ui.card().classes("w-full"):
        _title(f"{desk.opened.name}: {desk.kind.what if desk.known or desk.ways else 'not recognised'}")
        if desk.look is not None:
            _looked(desk.look)
        if desk.preview.pictures:
            with ui.row():
                for caption, uri in desk.preview.pictures:
                    with ui.column().classes("gap-0"):
                        ui.html(f'<img src="{uri}" alt="{caption}" style="max-width:240px;width:100%">', sanitize=False)
                        ui.label(caption).classes("text-xs")
        if desk.preview.points is not None and desk.preview.colors is not None:
            size = 0.006 * desk.preview.reach
            with ui.scene(width=300, height=260, grid=False) as scene:
                scene.point_cloud(desk.preview.points.tolist(), desk.preview.colors.tolist(), size)
                away = desk.preview.reach
                scene.move_camera(0, -1.3 * away, away, 0, 0, 0, duration=0)
        for name in desk.ways:
            _starter(desk, ACTIONS[name], desk.opened, refreshed)
        found = next((r for r in results_below(desk.opened) if r.folder == desk.opened), None)
        if found is not None:
            _result(desk, found, refreshed)
        elif desk.kind.name not in WAYS:
            ui.label(f"Next: {desk.kind.way_out(desk.opened)}").classes("text-sm break-all")


def _looked(look: Work) -> None:
    from nicegui import ui

    if look.state == "failed":
        _failure(look.result)
        return
    for key in ("wrong", "warnings", "problems"):
        for line in look.result.get(key) or ():
            ui.label(f"⚠ {line}").classes("text-sm")
    with ui.expansion("everything that was recognised").classes("w-full"):
        ui.html(f"<pre>{escape(_plain(look.result))}</pre>", sanitize=False)


def _starter(desk: Desk, action: Action, source: Path, refreshed: Callable[[], None]) -> None:
    """The inputs of an action, and its button."""
    from nicegui import ui

    values: dict[str, Any] = {}
    with ui.row().classes("w-full items-end"):
        for field in action.fields:
            if field.choices:
                values[field.option] = ui.select(list(field.choices), value=field.choices[0], label=field.label)
            else:
                values[field.option] = ui.input(field.label)
            values[field.option].props("dense outlined").classes("min-w-36")

        def begin() -> None:
            out = free_folder(desk.root, source, action.suffix)
            try:
                entered = {option: str(part.value or "") for option, part in values.items()}
                for field in action.fields:
                    if field.path and entered[field.option]:
                        entered[field.option] = str(desk.roots.source(entered[field.option]))
                arguments = arguments_of(action, source, out, entered)
            except RealsimError as error:
                _complain(error)
                return
            desk.start(f"{action.title}: {source.name}", arguments, out)
            refreshed()

        ui.button(action.title, icon="play_arrow", on_click=begin)


def _running(desk: Desk, refreshed: Callable[[], None]) -> None:
    from nicegui import ui

    if not desk.works:
        return
    with ui.card().classes("w-full"):
        _title("Commands")
        for work in desk.works:
            with ui.column().classes("w-full gap-1 border-b pb-2"):
                with ui.row().classes("w-full items-center"):
                    ui.badge(work.state, color=STATES[work.state])
                    ui.label(work.title).classes("font-medium grow break-all")
                    if not work.ended:
                        ui.button("Stop", on_click=lambda w=work: desk.cancel(w)).props("flat dense")
                if work.state == "running":
                    _progress_of(work)
                elif work.state == "failed":
                    _failure(work.result)
                ui.label(shlex.join(["realsim", *work.arguments])).classes("text-xs font-mono opacity-70 break-all")
                if work.state == "done" and work.out is not None:
                    found = next(iter(results_below(work.out)), None)
                    if found is not None:
                        _result(desk, found, refreshed)
                    else:
                        ui.label(f"written into {work.out}").classes("text-sm break-all")


def _progress_of(work: Work) -> None:
    """A line and a bar that follow the work in place."""
    from nicegui import ui

    line = ui.label().classes("text-sm")
    bar = ui.linear_progress(show_value=False)

    def follow() -> None:
        line.text, bar.value = _progress(work), work.share or 0.0
        bar.props(f'aria-label="{work.step or "starting"}"')
        bar.props(**{"add" if work.share is None else "remove": "indeterminate"})

    follow()
    ui.timer(0.5, follow)


def _progress(work: Work) -> str:
    spent = time.monotonic() - work.began
    share = "" if work.share is None else f", {work.share:.0%}"
    remaining = work.remaining()
    left = "" if remaining is None else f"; about {remaining:.0f} s left"
    return f"{work.step or 'starting'}{share}; {spent:.0f} s so far{left}"


def _report(desk: Desk, refreshed: Callable[[], None]) -> None:
    from urllib.parse import quote

    from nicegui import ui

    if desk.reading is None:
        return
    source = f"/report?folder={quote(str(desk.reading.folder))}"

    def close() -> None:
        desk.reading = None
        refreshed()

    ui.keyboard(on_key=lambda event: close() if event.key.escape and event.action.keydown else None)
    with ui.card().classes("w-full"):
        with ui.row().classes("w-full items-center"):
            _title(desk.reading.folder.name)
            ui.link("in a tab of its own", source, new_tab=True)
            ui.button("Close", on_click=close).props("flat dense")
        ui.html(
            f'<iframe src="{source}" title="report" sandbox="allow-scripts allow-downloads" allow="clipboard-write" '
            'style="width:100%;height:80vh;border:0"></iframe>',
            sanitize=False,
        ).classes("w-full")


def _results(desk: Desk, refreshed: Callable[[], None]) -> None:
    from nicegui import ui

    with ui.card().classes("w-full"):
        _title("Results in this folder")
        found = results_below(desk.root)
        if not found:
            ui.label("None yet. Open something above, or run `realsim demo --out demo_out` in a terminal.")
        for result in found:
            _result(desk, result, refreshed)


def _result(desk: Desk, result: Result, refreshed: Callable[[], None]) -> None:
    """A result as a line: verdict, report, and what can be done with it."""
    from nicegui import ui

    def read() -> None:
        desk.reading = result
        refreshed()

    def export(name: str) -> None:
        arguments = ("export", str(result.folder), f"--to={name}", "--overwrite")
        desk.start(f"Export {result.folder.name} as {name}", arguments, result.folder / "export")
        refreshed()

    with ui.row().classes("w-full items-center"):
        ui.badge(result.level or result.kind, color=COLORS.get(result.level, "grey"))
        with ui.column().classes("gap-0 grow"):
            ui.label(str(result.folder.relative_to(desk.root))).classes("font-medium break-all")
            when = datetime.fromtimestamp(result.when).strftime("%Y-%m-%d %H:%M")
            ui.label(f"{when}  {result.headline}").classes("text-sm")
        if result.page is not None:
            ui.button("Report", on_click=read).props("dense outline")
        if result.kind == "scene":
            with ui.dropdown_button("Export", auto_close=True).props("dense outline"):
                for name in FORMATS:
                    ui.item(name, on_click=lambda n=name: export(n))
        ui.button("Use it", on_click=lambda: _use(result)).props("dense outline")


def lines_to_use(result: Result) -> tuple[str, str]:
    """(Python, shell) that go on with a result, whatever characters its folder's name has."""
    folder = shlex.quote(str(result.folder))
    if result.kind == "scene":
        python = (
            f"import realsim as rs\n\nscene = rs.load_scene({str(result.folder)!r})\n"
            "model = scene.model()  # mujoco.MjModel"
        )
        view = f"python -m mujoco.viewer --mjcf={shlex.quote(str(result.folder / 'scene.xml'))}"
        return python, f"{view}\nrealsim finetune {folder} --out tuned"
    python = (
        "import mujoco\nimport realsim as rs\n\n"
        f"found = rs.load_diagnosis({str(result.folder)!r})\n"
        'spec = mujoco.MjSpec.from_file("CASE/model.xml")  # the model that was diagnosed\n'
        "rs.apply_patch(spec, found)"
    )
    return python, f"realsim finetune SCENE --diagnosis {folder} --out tuned"


def _use(result: Result) -> None:
    """How to go on with a result: lines to copy."""
    from nicegui import ui

    python, shell = lines_to_use(result)
    with ui.dialog() as dialog, ui.card().classes("w-full"):
        _title("Use it")
        ui.code(python, language="python").classes("w-full")
        ui.code(shell, language="bash").classes("w-full")
        ui.button("Close", on_click=dialog.close)
    dialog.open()


def _failure(result: dict[str, Any]) -> None:
    """An error as the command line shows it: file, expected, found, do."""
    from nicegui import ui

    ui.label(str(result.get("message", "it failed"))).classes("text-negative font-medium")
    for key, word in (("file", "file"), ("expected", "expected"), ("found", "found"), ("hint", "do")):
        if result.get(key):
            ui.html(f"<pre>{word:<9} {escape(str(result[key]))}</pre>", sanitize=False)


def _complain(error: RealsimError) -> Any:
    from nicegui import ui

    return ui.notification(error.render(), type="negative", multi_line=True, close_button="Close", timeout=None)


def _title(text: str) -> None:
    from nicegui import ui

    ui.label(text).classes("text-lg font-medium [overflow-wrap:anywhere]").props('role="heading" aria-level="2"')


def _plain(data: Any, indent: int = 0) -> str:
    """Nested values as indented lines."""
    pad = "  " * indent
    if isinstance(data, dict):
        lines = [
            f"{pad}{k}: {v}" if not isinstance(v, dict | list) else f"{pad}{k}:\n{_plain(v, indent + 1)}"
            for k, v in data.items()
            if v not in (None, "", [], {})
        ]
        return "\n".join(lines)
    if isinstance(data, list):
        return "\n".join(_plain(v, indent) if isinstance(v, dict) else f"{pad}- {v}" for v in data[:40])
    return f"{pad}{data}"
