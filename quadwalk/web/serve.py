"""Serve the page from this machine: its files, newer policies, and policies that need Python."""

import contextlib
import errno
import json
import logging
import mimetypes
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from http import HTTPStatus
from typing import Any, Protocol
from urllib.parse import unquote

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from quadwalk.errors import UsageError, UserError
from quadwalk.files import get_os_reason
from quadwalk.web.site import INDEX

SOCKET = "/live"  # where the page's websocket is
Content = bytes | Callable[[], bytes]  # of a file: now, or made when it is asked for
_LARGEST = 10_000  # bytes of a message from the page


class Actor(Protocol):
    """A policy that acts in Python for one page."""

    def __call__(
        self, time: float, qpos: list[float], qvel: list[float], command: list[float]
    ) -> list[float]:
        """Return the joint targets (12,), rad, of a state and a velocity command (3,).

        `time`, s, goes on from state to state until the robot starts anew.
        """
        ...


class PageServer:
    """A server of the page's files, with a websocket to each page that is open."""

    def __init__(self, host: str, port: int) -> None:
        self._files: Mapping[str, Content] = {}
        self._is_ready = threading.Event()
        self._make_actor: Callable[[], Actor] | None = None
        self._connections: set[ServerConnection] = set()
        self._policy: bytes | None = None  # the newest
        self._desk: str | None = None  # the newest state of the desk, as the page gets it
        self.on_message: Callable[[str], object] | None = None  # gets what pages send to a training
        for name in ("websockets", "websockets.server"):  # they would log a traceback
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.host, self.port = host, find_free_port(host, port)
        self._server: Server = serve(
            self._serve_socket,
            host,
            self.port,
            process_request=self._answer_request,
            max_size=_LARGEST,
        )
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        return make_url(self.host, self.port)

    def set_files(
        self, files: Mapping[str, Content], make_actor: Callable[[], Actor] | None = None
    ) -> None:
        """Serve these files, by name, in place of earlier ones; requests wait for the first call.

        `make_actor` makes the actor of each page that opens; None: the pages act themselves.
        """
        self._files, self._make_actor = files, make_actor
        self._is_ready.set()

    def send_policy(self, policy: bytes) -> None:
        """Send a newer policy, as of `site.pack_policy`, to all pages, also to later ones."""
        self._policy = policy
        self._send_to_all(policy)

    def forward(self, text: str) -> None:
        """Send a message of a training to all pages; the state of the desk to later ones too."""
        with contextlib.suppress(ValueError, AttributeError):  # then it is none
            if json.loads(text).get("type") == "desk":
                self._desk = text
        self._send_to_all(text)

    def _send_to_all(self, text: str | bytes) -> None:
        for connection in list(self._connections):
            with contextlib.suppress(ConnectionClosed):
                connection.send(text)

    def close(self) -> None:
        """End the server and its connections."""
        self._is_ready.set()
        self._server.shutdown()
        for connection in list(self._connections):
            connection.close()
        self._thread.join()

    def _answer_request(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for a file; None for that of a websocket."""
        path = request.path.partition("?")[0]
        if path == SOCKET:
            origin = request.headers.get("Origin", "")
            same = origin.partition("://")[2] == request.headers.get("Host")
            return (
                None if same else _make_response(HTTPStatus.FORBIDDEN, b"another page's websocket")
            )
        self._is_ready.wait()
        name = unquote(path).removeprefix("/") or INDEX
        content = self._files.get(name)
        if callable(content):
            try:
                content = content()
            except UserError as error:
                return _make_response(HTTPStatus.INTERNAL_SERVER_ERROR, str(error).encode())
        if content is None:
            return _make_response(HTTPStatus.NOT_FOUND, b"no such file")
        kind = mimetypes.guess_type(name)[0] if not name.endswith(".gz") else None
        if name.endswith(".js"):  # some systems call it text/plain, which browsers refuse
            kind = "text/javascript"
        return _make_response(HTTPStatus.OK, content, kind or "application/octet-stream")

    def _serve_socket(self, connection: ServerConnection) -> None:
        """Send the newest policy to a page, act for it where it asks, and forward the rest."""
        self._connections.add(connection)
        actor = self._make_actor() if self._make_actor else None
        try:
            for newest in (self._policy, self._desk):
                if newest is not None:
                    connection.send(newest)
            for text in connection:
                state = json.loads(text)
                if self.on_message is not None and "type" in state:
                    self.on_message(json.dumps(state))  # on one line
                    continue
                if actor is None:
                    continue
                targets = actor(*(state[name] for name in ("time", "qpos", "qvel", "command")))
                connection.send(json.dumps(targets))
        except (ConnectionClosed, ValueError, KeyError, TypeError):
            pass  # a page that is gone, or what no page of ours would send
        finally:
            self._connections.discard(connection)


@contextlib.contextmanager
def serve_page(host: str, port: int) -> Iterator[PageServer]:
    """Serve the page while the context is open, at `port` or the next port that is free."""
    server = PageServer(host, port)
    try:
        yield server
    finally:
        server.close()


def _make_response(status: HTTPStatus, content: bytes, kind: str = "text/plain") -> Response:
    headers = {
        "Content-Type": kind,
        "Content-Length": str(len(content)),
        "Cache-Control": "no-cache",
        "Connection": "close",
        "X-Content-Type-Options": "nosniff",
    }
    return Response(status.value, status.phrase, Headers(headers), content)


def make_url(host: str, port: int) -> str:
    """Return the URL of a page served at `host`; 0.0.0.0 and :: become this machine's address."""
    if host in ("0.0.0.0", "::"):
        host = find_own_address()
    name = "localhost" if host == "127.0.0.1" else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}"


def find_own_address() -> str:
    """Return this machine's IPv4 address in its network; without a network, its host name."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing; the system chooses a way there
        except OSError:
            return socket.gethostname()
        address: str = probe.getsockname()[0]
        return address


def find_free_port(host: str, port: int) -> int:
    """Return the first free port at `host` from `port` on.

    Raises `UsageError` unless `host` is an address of this machine, `UserError` if no port is free.
    """
    try:
        info: Any = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        family, (address, _, *scope) = info[0], info[4]
        for free in range(port, 65536):
            try:
                socket.create_server((address, free, *scope), family=family).close()
                return free
            except OSError as error:
                if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                    raise
    except (OSError, ValueError) as error:  # ValueError: a name that no host can have
        reason = get_os_reason(error) if isinstance(error, OSError) else error
        raise UsageError(
            f"--host is {host!r}: {reason}; expected an address of this machine"
        ) from None
    raise UserError(f"no port from {port} on is free at {host}")
