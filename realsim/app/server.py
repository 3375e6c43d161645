"""Serves the page on 127.0.0.1: address with a token, reports of finished results, files that were dropped."""

import signal
from pathlib import Path
from secrets import token_urlsafe
from typing import Any

from realsim.app.gallery import result_of
from realsim.app.guard import Guard
from realsim.app.page import Desk, show
from realsim.cli.roots import Roots
from realsim.core.errors import RealsimError
from realsim.report.live import check_port


def serve(folder: Path, port: int = 0, token: str = "", open_browser: bool = True) -> None:
    """Serve the page until it is interrupted.

    Args:
        folder: what is opened and written lies below it.
        port: on 127.0.0.1; a free one if 0.
        token: for the address; a new one if empty.
    """
    from fastapi.responses import FileResponse, PlainTextResponse
    from nicegui import app, ui

    desk = Desk(Roots([folder]))
    token, port = token or token_urlsafe(24), check_port(port)
    app.add_middleware(Guard, token=token)

    @app.get("/report")
    def report(folder: str) -> Any:
        try:
            result = result_of(desk.roots.path(folder))
        except RealsimError as error:
            return PlainTextResponse(error.render(), 404)
        if result is None or result.page is None:
            return PlainTextResponse("no report there", 404)
        return FileResponse(result.page, media_type="text/html")

    address = f"http://127.0.0.1:{port}/?token={token}"
    print(f"realsim app: {address}\nfolder: {folder.resolve()} (end with Ctrl-C)", flush=True)
    ui.page("/", title="realsim")(lambda: show(desk))
    app.on_shutdown(desk.close)
    # The server ends at Ctrl-C by itself, then raises the signal once more: to end so is no failure.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ui.run(
        host="127.0.0.1", port=port, title="realsim", reload=False, show=f"/?token={token}" if open_browser else False,
        show_welcome_message=False, favicon="🦿", dark=None,
    )  # fmt: skip
