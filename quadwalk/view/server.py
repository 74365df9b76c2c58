"""The web server of the page. It comes first, so that a browser loads the page while we load."""

import contextlib
import errno
import io
import logging
import socket
from collections.abc import Iterator

import viser
from rich.console import Console

from quadwalk.errors import UsageError, UserError
from quadwalk.files import get_os_reason


@contextlib.contextmanager
def serving(host: str, port: int, console: Console) -> Iterator[viser.ViserServer]:
    """A page that says that it loads; `port`, or the next that is free.

    What a client sends that is no message ends its connection, and is no news.
    """
    free = _free_port(host, port)
    if free != port:
        console.print(f"port {port} is taken, so the page is at port {free}")
    port = free
    for name in ("websockets.server", "asyncio"):  # they would log a traceback
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with contextlib.redirect_stdout(io.StringIO()):  # it would print a box
        server = viser.ViserServer(host=host, port=port, label="quadwalk", verbose=False)
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.gui.add_markdown("loading")
    console.print(f"drive it at {url_of(host, server.get_port())} (Ctrl-C ends)")
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def url_of(host: str, port: int) -> str:
    """Where a browser finds the page that is served at `host`."""
    shown = "localhost" if host == "127.0.0.1" else f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}"


def _free_port(host: str, port: int) -> int:
    """`port` or the next that is free; raises where viser would wait for ever."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, (address, _, *scope) = found[0]
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
