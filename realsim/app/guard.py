"""Who may ask the page: a browser on this machine that knows the token."""

from collections.abc import Awaitable, Callable
from http.cookies import CookieError, SimpleCookie
from secrets import compare_digest
from typing import Any
from urllib.parse import parse_qs

Scope = dict[str, Any]
Send = Callable[[dict[str, Any]], Awaitable[None]]
COOKIE = "realsim_token"
HOSTS = ("127.0.0.1", "localhost")


class Guard:
    """ASGI middleware that refuses requests and web sockets without the token.

    The first request has it in its address (`?token=...`); it then moves into a cookie, so that it does not stay in the
    history. Another site's page cannot read the cookie (SameSite), and a name that resolves to this machine is refused.
    """

    def __init__(self, app: Callable[..., Awaitable[None]], token: str) -> None:
        self.app, self.token = app, token

    async def __call__(self, scope: Scope, receive: Any, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if headers.get("host", "").partition(":")[0] not in HOSTS:
            await _refuse(scope, send, "this page is for browsers on the machine that it runs on")
        elif compare_digest(given.encode(), self.token.encode()) and scope["type"] == "http":
            await _redirect(send, scope["path"], self.token)
        elif compare_digest(_cookie(headers.get("cookie", "")).encode(), self.token.encode()):
            await self.app(scope, receive, send)
        else:
            await _refuse(scope, send, "open the address that `realsim app` printed: it has the token")


def _cookie(header: str) -> str:
    try:
        found = SimpleCookie(header).get(COOKIE)
    except CookieError:
        return ""
    return "" if found is None else found.value


async def _redirect(send: Send, path: str, token: str) -> None:
    cookie = f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict"
    headers = [(b"location", path.encode()), (b"set-cookie", cookie.encode()), (b"referrer-policy", b"no-referrer")]
    await send({"type": "http.response.start", "status": 303, "headers": headers})
    await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Scope, send: Send, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": f"realsim: {reason}\n".encode()})
