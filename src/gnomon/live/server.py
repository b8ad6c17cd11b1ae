"""The page of a guided capture: one file of HTML, CSS and JavaScript each, and what is known as events.

Only who knows the token sees anything; it is in the address that is opened. Each client is sent the newest state when
it can take it, and nothing waits for it: the recording goes on whatever clients do.
"""

import asyncio
import json
import threading
import time
import webbrowser
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from io import BytesIO
from ipaddress import ip_address
from pathlib import Path
from typing import Any, TextIO

from ..errors import OptionError, RecordingError, install_line
from ..local_server import Identity, LocalServer
from .camera_session import CameraSession
from .session import LiveSession
from .sources import PushSource

_EVENT_S = 0.1
_STATE_S = 0.5
_MOST_CLIENTS = 16
_LONGEST_PUSH = 4 << 20
_LAST_S = 20.0
_POLICY = "script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; form-action 'none'"
_KINDS = {".css": "text/css", ".js": "text/javascript"}
Session = LiveSession | CameraSession


class LivePage(LocalServer):
    """Serves the page of a session, in a thread of its own.

    Parameters
    ----------
    session : what is shown
    port : 0 is any that is free
    lan : whether other devices may see it
    tls : whether it is served under a certificate of its own making

    Raises
    ------
    OptionError
        If what it needs is not installed, or the port is taken.
    """

    def __init__(self, session: Session, *, port: int = 0, lan: bool = False, tls: bool = False) -> None:
        self.session = session
        self._clients, self._result, self._fetched = 0, "", threading.Event()
        self._report: Path | None = None
        super().__init__(
            [
                *((path, "GET", self._file) for path in ("/", "/live.css", "/live.js", f"/{session.page}.js")),
                ("/picture", "GET", self._picture),
                ("/code.svg", "GET", self._code),
                ("/events", "GET", self._events),
                ("/report", "GET", self._show_report),
                ("/stop", "POST", self._stop),
                ("/push", "POST", self._push),
            ],
            policy=_POLICY,
            install=f"Run: {install_line('gnomon[live]')} or use --no-browser.",
            port=port,
            lan=lan,
            identify=own_identity if tls else None,
        )
        self._wanted = self.push_address if isinstance(session.source, PushSource) else self.address
        self._for_phone = self._wanted if lan else ""

    @property
    def address(self) -> str:
        """Where the page is, with its token."""
        return self.address_of()

    @property
    def push_address(self) -> str:
        """Where a phone sends its samples to."""
        return self.address_of("/push")

    def draw_address(self, out: TextIO) -> None:
        """Draw the address, or that to push to, as a QR code in a terminal; it holds the token."""
        with suppress(ImportError):  # the address is printed as well
            import segno

            segno.make(self._wanted, error="l").terminal(out, compact=True)

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
        self.end_serving()

    async def _file(self, request: Any) -> Any:
        first = request.url.path == "/"
        name = f"{self.session.page}.html" if first else request.url.path[1:]
        content = (files("gnomon.live") / "page" / name).read_bytes()
        return self.answer(content, _KINDS.get(Path(name).suffix, "text/html"), first=first)

    async def _picture(self, _request: Any) -> Any:
        content = self.session.picture() if isinstance(self.session, CameraSession) else b""
        return self.answer(content, "image/jpeg") if content else self.say("There is no picture.", 404)

    async def _code(self, _request: Any) -> Any:
        """Answer with the QR code of what a phone needs."""
        if not self._for_phone:
            return self.say("No other device sees this page: begin with --lan.", 404)
        try:
            import segno
        except ImportError:
            return self.say(f"Run: {install_line('gnomon[live]')}", 404)
        content = BytesIO()
        segno.make(self._for_phone, error="l").save(content, kind="svg", scale=5, light="white")
        return self.answer(content.getvalue(), "image/svg+xml")

    async def _events(self, _request: Any) -> Any:
        from starlette.responses import StreamingResponse

        if self._clients >= _MOST_CLIENTS:
            return self.say("Too many pages are open.", 503)
        return StreamingResponse(self._stream(), media_type="text/event-stream", headers=self.headers)

    async def _stream(self) -> AsyncIterator[str]:
        """Yield the newest samples ten times a second and what is known twice a second."""
        self._clients += 1
        try:
            last_s, told = -1.0, 0.0
            while not self._server.should_exit:
                now = time.monotonic()
                if now - told >= _STATE_S or self._result:
                    told = now
                    document = {
                        **self.session.document(),
                        "result": self._result,
                        "stopped": self.stopped,
                        "phone": self._for_phone,
                    }
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
        self.session.stopped.set()
        return self.say("stopped")

    async def _push(self, request: Any) -> Any:
        source = self.session.source
        if not isinstance(source, PushSource):
            return self.say("The source is another one.", 409)
        body = b""
        async for piece in request.stream():
            body += piece
            if len(body) > _LONGEST_PUSH:
                return self.say("Too long.", 413)
        try:
            count = source.take_push(body)
        except RecordingError as error:
            return self.say(str(error), 400)
        return self.say(f"{count} samples")

    async def _show_report(self, _request: Any) -> Any:
        from starlette.responses import FileResponse

        self._fetched.set()
        if self._report is None:
            return self.say("There is no report.", 404)
        return FileResponse(self._report, media_type="text/html", headers={"Cache-Control": "no-store"})


def own_identity(hosts: Sequence[str]) -> Identity:
    """Return a certificate for names and addresses of this computer, with its key (elliptic curve P-256).

    So nobody in the network reads along. No authority signed it: a browser warns once, and who compares the fingerprint
    that the terminal prints knows it is this page. It is made anew for each run, for a day, and kept in memory.

    Raises
    ------
    OptionError
        If what it needs is not installed.
    """
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.x509.oid import ExtendedKeyUsageOID
    except ImportError:
        raise OptionError(f"--tls needs cryptography. Run: {install_line('gnomon[tls]')}") from None
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "gnomon live")])
    named = [
        x509.IPAddress(ip_address(host)) if host[0].isdigit() else x509.DNSName(host) for host in dict.fromkeys(hosts)
    ]
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName(named), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )
    form = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    return Identity(
        certificate=certificate.public_bytes(serialization.Encoding.PEM),
        key=key.private_bytes(serialization.Encoding.PEM, *form),
        fingerprint=certificate.fingerprint(hashes.SHA256()).hex(":").upper(),
    )
