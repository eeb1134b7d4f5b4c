"""The live view as a page of a server that only this machine can reach, and that asks nothing of any other.

The address holds a random token; whoever does not know it, another user of the machine say, is refused. What a browser
is started with, everybody can read: that is another address, which leads to the page once. The ``Host`` of
a request must be the server's own, so that no name that somebody made to point here is taken for it, and so must the
``Origin``, so that no other page of the same browser gets an answer.
"""

import secrets
import socket
from collections.abc import Callable
from contextlib import suppress
from importlib.resources import files
from json import JSONDecodeError

import anyio
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from .live import Live

LOOPBACK = "127.0.0.1"
LARGEST = 2**20  # bytes of a message
KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY, "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}  # fmt: skip
"""The page's scripts, styles and pictures are its own; nothing is kept, and no other site learns the address."""


def application(live: Live, token: str, port: int, once: str = "") -> ASGIApp:
    """The page under ``/TOKEN/``, and what answers it; ``/ONCE`` leads there, the first time."""
    pages = [Route(f"/{token}/{name}", _sent(name or "view.html")) for name in ("", "view.js", "page.js", "view.css")]
    if once:
        pages.append(Route(f"/{once}", _leading_once(f"/{token}/")))
    whole = Starlette(routes=[*pages, WebSocketRoute(f"/{token}/live", lambda socket: _answered(socket, live))])
    return _Guarded(whole, port)


def _leading_once(to: str) -> Callable[[Request], Response]:
    unused = [True]

    def answer(_: Request) -> Response:
        return RedirectResponse(to, headers=HEADERS) if unused and unused.pop() else Response(status_code=404)

    return answer


class _Guarded:
    """Refuses what does not come from its own page."""

    def __init__(self, app: ASGIApp, port: int) -> None:
        self.app, self.hosts = app, {f"{LOOPBACK}:{port}", f"localhost:{port}"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            headers = Headers(scope=scope)
            origin, needed = headers.get("origin"), scope["type"] == "websocket"
            own = origin in {f"http://{host}" for host in self.hosts} if origin or needed else True
            if headers.get("host") not in self.hosts or not own:
                refuse = WebSocket(scope, receive, send).close() if needed else _refusal(scope, receive, send)
                return await refuse
        await self.app(scope, receive, send)


async def _refusal(scope: Scope, receive: Receive, send: Send) -> None:
    await Response("not from here\n", 403, media_type="text/plain")(scope, receive, send)


def _sent(name: str) -> Callable[[Request], Response]:
    def send(request: Request) -> Response:
        found = files("merlfit.fitting.view").joinpath("page", name)
        return Response(found.read_bytes(), headers=HEADERS, media_type=KINDS[f".{name.rpartition('.')[2]}"])

    return send


async def _answered(socket: WebSocket, live: Live) -> None:
    """Tell what there is, then answer messages, each in a thread of its own: frames do not wait for costs."""
    await socket.accept()
    sending = anyio.Lock()

    async def answer(message: dict) -> None:
        found = await anyio.to_thread.run_sync(live.answer, message)
        with suppress(WebSocketDisconnect, RuntimeError):  # the page was closed meanwhile; Starlette raises either
            async with sending:
                await socket.send_json(found)

    async with anyio.create_task_group() as tasks:
        try:
            await socket.send_json({"about": live.about})
            while True:
                message = await socket.receive_json()
                if isinstance(message, dict):
                    tasks.start_soon(answer, message)
        except (WebSocketDisconnect, JSONDecodeError):
            tasks.cancel_scope.cancel()


def serve(live: Live, port: int, ready: Callable[[str, str], None]) -> None:
    """Serve until the program is stopped.

    Args:
        port: 0 for any that is free. ready: called with the page's address, which holds the token, and with one that
            leads there once.

    Raises:
        OSError: something else has the port.
    """
    with socket.create_server((LOOPBACK, port)) as listening:
        port, token, once = listening.getsockname()[1], secrets.token_urlsafe(16), secrets.token_urlsafe(16)
        settings = uvicorn.Config(
            application(live, token, port, once), log_level="warning", access_log=False, server_header=False,
            ws_max_size=LARGEST, timeout_graceful_shutdown=1, proxy_headers=False,
        )  # fmt: skip
        ready(*(f"http://{LOOPBACK}:{port}/{path}" for path in (f"{token}/", once)))
        uvicorn.Server(settings).run(sockets=[listening])
