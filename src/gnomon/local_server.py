"""Pages for one person, served in a thread of their own: only who knows the token sees anything.

The token is in the address that is opened, and then in a cookie. Requests to another host name (DNS rebinding) or from
another page are refused.
"""

import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from .errors import OptionError

Handler = Callable[[Any], Awaitable[Any]]
_MOST_CONNECTIONS = 256
_LONGEST_QUERY = 8192
_POLICY = "base-uri 'none'; frame-ancestors 'none'"


class Identity(NamedTuple):
    """A certificate and its key, in PEM, and its fingerprint (SHA-256)."""

    certificate: bytes
    key: bytes
    fingerprint: str


class LocalServer:
    """Serves pages to this computer.

    Parameters
    ----------
    routes : (path, method, what answers) of all that is served
    policy : Content-Security-Policy of what the pages may load
    install : what to do where Starlette or uvicorn is missing
    port : 0 is any that is free
    lan : whether other devices of the network may see it
    identify : makes the identity for some hosts by which it is served over TLS; None serves it as it is

    Raises
    ------
    OptionError
        If what it needs is not installed, or the port is taken.
    """

    def __init__(
        self,
        routes: Sequence[tuple[str, str, Handler]],
        *,
        policy: str,
        install: str,
        port: int = 0,
        lan: bool = False,
        identify: Callable[[Sequence[str]], Identity] | None = None,
    ) -> None:
        try:
            import uvicorn
            from starlette.applications import Starlette
            from starlette.routing import Route
        except ImportError:
            raise OptionError(f"the page needs Starlette and uvicorn. {install}") from None
        self._hosts = ["localhost", "127.0.0.1", *([_own_address()] if lan else [])]
        identity = None if identify is None else identify(self._hosts)
        self._scheme, self.fingerprint = ("http", "") if identity is None else ("https", identity.fingerprint)
        self.token = secrets.token_urlsafe(24)
        self.headers: Mapping[str, str] = {
            "Content-Security-Policy": f"default-src 'none'; {policy}; {_POLICY}",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
        }
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind(("0.0.0.0" if lan else "127.0.0.1", port))
            self._socket.listen()  # who comes before it serves waits
        except (OSError, OverflowError) as error:
            raise OptionError(
                f"--port {port}: the page cannot be served there ({error}). Choose another port."
            ) from None
        self.port = int(self._socket.getsockname()[1])
        self.app = self._guarded(Starlette(routes=[Route(path, do, methods=[method]) for path, method, do in routes]))
        options = uvicorn.Config(
            self.app,
            log_level="critical",
            timeout_graceful_shutdown=1,
            lifespan="off",
            limit_concurrency=_MOST_CONNECTIONS,
            server_header=False,
        )
        if identity is not None:
            _load_identity(options, identity)
        self._server = uvicorn.Server(options)
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), daemon=True)

    def address_of(self, path: str = "/") -> str:
        """Return where a path is, with the token."""
        return f"{self._scheme}://{self._hosts[-1]}:{self.port}{path}?token={self.token}"

    def begin_serving(self) -> None:
        """Begin to serve, in a thread of its own."""
        self._thread.start()

    def serve_until_interrupted(self) -> None:
        """Serve until Ctrl-C."""
        self.begin_serving()
        try:
            while self._thread.is_alive():
                self._thread.join(0.2)
        except KeyboardInterrupt:
            self.end_serving()

    def end_serving(self) -> None:
        """End it."""
        self._server.should_exit = True
        self._thread.join(timeout=3.0)

    def answer(self, content: bytes, kind: str, *, first: bool = False) -> Any:
        """Return an answer; the `first` page gives the browser the token for all that follow."""
        from starlette.responses import Response

        answer = Response(content, media_type=kind, headers=self.headers)
        if first:
            secure = self._scheme == "https"
            answer.set_cookie(self._cookie, self.token, httponly=True, samesite="strict", secure=secure)
        return answer

    def say(self, text: str, status: int = 200) -> Any:
        """Return an answer of plain text."""
        from starlette.responses import PlainTextResponse

        return PlainTextResponse(text, status_code=status, headers=self.headers)

    def _guarded(self, app: Any) -> Any:
        """Let in only requests to this host, from this page, with the token."""

        async def guarded(scope: Any, receive: Any, send: Any) -> None:
            """Answer one request, as the interface of ASGI has it."""
            from starlette.requests import Request

            if scope["type"] != "http":
                return
            refusal = self._refusal(Request(scope, receive))
            await (app if refusal is None else self.say(refusal[1], refusal[0]))(scope, receive, send)

        return guarded

    def _refusal(self, request: Any) -> tuple[int, str] | None:
        """Return status and reason where a request is refused."""
        if len(request.scope["query_string"]) > _LONGEST_QUERY:
            return 414, "The address is too long."
        own = {f"{host}:{self.port}" for host in self._hosts}
        if request.headers.get("host", "") not in own:
            return 400, "This page has another address."
        origin = request.headers.get("origin")
        if origin is not None and origin not in {f"{self._scheme}://{host}" for host in own}:
            return 403, "This page may not be used from another one."
        given = request.query_params.get("token") or request.cookies.get(self._cookie, "")
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            return 403, "The token is missing: open the address that gnomon printed."
        return None

    @property
    def _cookie(self) -> str:
        return f"gnomon-{self.port}"


def _load_identity(options: Any, identity: Identity) -> None:
    """Have uvicorn's options load a certificate with its key, which it takes from files alone."""
    with TemporaryDirectory(prefix="gnomon-") as folder:  # for this user only
        for name, content in (("ssl_certfile", identity.certificate), ("ssl_keyfile", identity.key)):
            path = Path(folder) / name
            path.write_bytes(content)
            setattr(options, name, str(path))
        options.load()


def _own_address() -> str:
    """Return this computer's address in its network; nothing is sent to find it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"
