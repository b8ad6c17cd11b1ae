"""The page of a guided capture: one file of HTML, CSS and JavaScript each, and what is known as events.

Only who knows the token sees anything; it is in the address that is opened. Each client is sent the newest state when
it can take it, and nothing waits for it: the recording goes on whatever clients do.
"""

import asyncio
import json
import secrets
import socket
import threading
import time
import webbrowser
from collections.abc import AsyncIterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from ..errors import OptionError, RecordingError
from .session import LiveSession
from .sources import INSTALL, PushSource

_EVENT_S = 0.1
_STATE_S = 0.5
_MOST_CLIENTS = 16
_LONGEST_PUSH = 4 << 20
_LAST_S = 20.0
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_FILES = {
    "/": ("live.html", "text/html"),
    "/live.css": ("live.css", "text/css"),
    "/live.js": ("live.js", "text/javascript"),
}


class LivePage:
    """Serves the page of a session, in a thread of its own.

    Parameters
    ----------
    session : what is shown
    port : 0 is any that is free
    lan : whether other devices may see it

    Raises
    ------
    OptionError
        If what it needs is not installed, or the port is taken.
    """

    def __init__(self, session: LiveSession, *, port: int = 0, lan: bool = False) -> None:
        try:
            import uvicorn
            from starlette.applications import Starlette
            from starlette.routing import Route
        except ImportError:
            raise OptionError(f"the page needs Starlette and uvicorn. {INSTALL}, or use --no-browser.") from None
        self.session, self.token = session, secrets.token_urlsafe(24)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind(("0.0.0.0" if lan else "127.0.0.1", port))
        except (OSError, OverflowError) as error:
            raise OptionError(
                f"--port {port}: the page cannot be served there ({error}). Choose another port."
            ) from None
        self.port = int(self._socket.getsockname()[1])
        self._hosts = ["localhost", "127.0.0.1", *([_own_address()] if lan else [])]
        self._clients, self._result, self._fetched = 0, "", threading.Event()
        self._report: Path | None = None
        routes = [Route(path, self._file) for path in _FILES]
        routes += [
            Route("/events", self._events),
            Route("/report", self._show_report),
            Route("/stop", self._stop, methods=["POST"]),
            Route("/push", self._push, methods=["POST"]),
        ]
        self.app = self._guarded(Starlette(routes=routes))
        options = uvicorn.Config(self.app, log_level="critical", timeout_graceful_shutdown=1, lifespan="off")
        self._server = uvicorn.Server(options)
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), daemon=True)

    @property
    def address(self) -> str:
        """Where the page is, with its token."""
        return f"http://{self._hosts[-1]}:{self.port}/?token={self.token}"

    @property
    def push_address(self) -> str:
        """Where a phone sends its samples to."""
        return f"http://{self._hosts[-1]}:{self.port}/push?token={self.token}"

    def begin_serving(self) -> None:
        """Begin to serve, in a thread of its own."""
        self._thread.start()

    def open_in_browser(self) -> None:
        """Show the page."""
        webbrowser.open(self.address)

    def show_result(self, report: Path) -> None:
        """Say how it ended, lead to the report, and end when it was fetched, or soon."""
        self._report = report if report.is_file() else None
        self._result = "done" if self._report else "failed"
        end_s = time.monotonic() + _LAST_S
        while self._clients and not self._fetched.is_set() and time.monotonic() < end_s:
            time.sleep(_EVENT_S)
        if self._report is not None:
            self._fetched.wait(2 * _STATE_S)  # from a page that was told, and asks now
            time.sleep(_STATE_S)
        self._server.should_exit = True
        self._thread.join(timeout=3.0)

    def _guarded(self, app: Any) -> Any:
        """Let in only requests to this host, from this page, with the token."""

        async def guarded(scope: Any, receive: Any, send: Any) -> None:
            """Answer one request, as the interface of ASGI has it."""
            from starlette.requests import Request
            from starlette.responses import PlainTextResponse

            if scope["type"] != "http":
                return
            request = Request(scope, receive)
            refusal = self._refusal(request)
            if refusal is not None:
                await PlainTextResponse(refusal[1], status_code=refusal[0], headers=_HEADERS)(scope, receive, send)
                return
            await app(scope, receive, send)

        return guarded

    def _refusal(self, request: Any) -> tuple[int, str] | None:
        """Return status and reason where a request is refused."""
        own = {f"{host}:{self.port}" for host in self._hosts}
        if request.headers.get("host", "") not in own:
            return 400, "This page has another address."
        origin = request.headers.get("origin")
        if origin is not None and origin not in {f"http://{host}" for host in own}:
            return 403, "This page may not be used from another one."
        given = request.query_params.get("token") or request.cookies.get(self._cookie, "")
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            return 403, "The token is missing: open the address that gnomon live printed."
        return None

    @property
    def _cookie(self) -> str:
        return f"gnomon-{self.port}"

    async def _file(self, request: Any) -> Any:
        from starlette.responses import Response

        name, kind = _FILES[request.url.path]
        answer = Response((files("gnomon.live") / "page" / name).read_bytes(), media_type=kind, headers=_HEADERS)
        if request.url.path == "/":
            answer.set_cookie(self._cookie, self.token, httponly=True, samesite="strict")
        return answer

    async def _events(self, _request: Any) -> Any:
        from starlette.responses import PlainTextResponse, StreamingResponse

        if self._clients >= _MOST_CLIENTS:
            return PlainTextResponse("Too many pages are open.", status_code=503, headers=_HEADERS)
        return StreamingResponse(self._stream(), media_type="text/event-stream", headers=_HEADERS)

    async def _stream(self) -> AsyncIterator[str]:
        """Yield the newest samples ten times a second and what is known twice a second."""
        self._clients += 1
        try:
            last_s, told = -1.0, 0.0
            while not self._server.should_exit:
                now = time.monotonic()
                if now - told >= _STATE_S or self._result:
                    told = now
                    document = {**self.session.document(), "result": self._result, "stopped": self.stopped}
                    yield f"event: state\ndata: {json.dumps(document)}\n\n"
                    if self._result:
                        return
                rows = [row for row in list(self.session.trace) if row[0] > last_s]
                if rows:
                    last_s = rows[-1][0]
                    yield f"event: trace\ndata: {json.dumps(rows)}\n\n"
                await asyncio.sleep(_EVENT_S)
        finally:
            self._clients -= 1

    @property
    def stopped(self) -> bool:
        """Whether the recording is at its end."""
        return self.session.stopped.is_set()

    async def _stop(self, _request: Any) -> Any:
        from starlette.responses import PlainTextResponse

        self.session.stopped.set()
        return PlainTextResponse("stopped", headers=_HEADERS)

    async def _push(self, request: Any) -> Any:
        from starlette.responses import PlainTextResponse

        source = self.session.source
        if not isinstance(source, PushSource):
            return PlainTextResponse("The source is another one.", status_code=409, headers=_HEADERS)
        body = b""
        async for piece in request.stream():
            body += piece
            if len(body) > _LONGEST_PUSH:
                return PlainTextResponse("Too long.", status_code=413, headers=_HEADERS)
        try:
            count = source.take_push(body)
        except RecordingError as error:
            return PlainTextResponse(str(error), status_code=400, headers=_HEADERS)
        return PlainTextResponse(f"{count} samples", headers=_HEADERS)

    async def _show_report(self, _request: Any) -> Any:
        from starlette.responses import FileResponse, PlainTextResponse

        self._fetched.set()
        if self._report is None:
            return PlainTextResponse("There is no report.", status_code=404, headers=_HEADERS)
        return FileResponse(self._report, media_type="text/html", headers={"Cache-Control": "no-store"})


def _own_address() -> str:
    """Return this computer's address in its network; nothing is sent to find it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"
