"""The web server of the page. It comes first, so that a browser loads the page while we load."""

import contextlib
import io
from collections.abc import Iterator

import viser
from rich.console import Console

from quadwalk.errors import UserError


@contextlib.contextmanager
def serving(host: str, port: int, console: Console) -> Iterator[viser.ViserServer]:
    """A page that says that it loads; `port`, or the next that is free."""
    with contextlib.redirect_stdout(io.StringIO()):  # it would print a box
        try:
            server = viser.ViserServer(host=host, port=port, label="quadwalk", verbose=False)
        except (OSError, RuntimeError) as error:
            raise UserError(f"cannot serve a page at {host}:{port}: {error}") from error
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.gui.add_markdown("loading")
    shown = "localhost" if host == "127.0.0.1" else host
    console.print(f"drive it at http://{shown}:{server.get_port()} (Ctrl-C ends)")
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
