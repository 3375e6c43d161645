"""Nobody reaches the page without its token, nor from another machine's name."""

import asyncio
from typing import Any

import pytest

from realsim.app.guard import COOKIE, Guard

TOKEN = "right"


def asked(kind: str = "http", query: str = "", cookie: str = "", host: str = "127.0.0.1:80") -> list[dict[str, Any]]:
    """What is sent back to a request."""
    sent: list[dict[str, Any]] = []

    async def page(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "reached"})

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    headers = [(b"Host", host.encode()), (b"cookie", cookie.encode())]
    scope = {"type": kind, "path": "/", "query_string": query.encode(), "headers": headers}
    asyncio.run(Guard(page, TOKEN)(scope, None, send))
    return sent


def test_the_token_moves_from_the_address_into_a_cookie() -> None:
    first = asked(query=f"token={TOKEN}")[0]
    assert first["status"] == 303
    cookie = dict(first["headers"])[b"set-cookie"].decode()
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert asked(cookie=cookie.partition(";")[0]) == [{"type": "reached"}]


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    "request_of", [{}, {"query": "token=wrong"}, {"cookie": f"{COOKIE}=wrong"}, {"cookie": "=;="}, {"query": "token="}]
)
def test_nothing_else_gets_in(kind: str, request_of: dict[str, str]) -> None:
    sent = asked(kind, **request_of)
    assert sent[0].get("status") == 403 if kind == "http" else sent[0]["type"] == "websocket.close"


def test_another_host_name_is_refused_even_with_the_token() -> None:
    assert asked(cookie=f"{COOKIE}={TOKEN}", host="evil.example")[0]["status"] == 403
    assert asked(cookie=f"{COOKIE}={TOKEN}", host="localhost:8080") == [{"type": "reached"}]
