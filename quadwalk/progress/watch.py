"""A page in which the newest policy of a training is seen live, from a process of its own."""

import contextlib
import importlib.util
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from quadwalk.cli.shell import suggest_install
from quadwalk.errors import UserError

WATCHED = 20  # times that the policy is saved for the page between two checkpoints


def check_watch() -> None:
    """Raise `UserError` where a package that the page needs is missing."""
    if importlib.util.find_spec("onnx") is None:
        raise UserError(f"--watch needs onnx, which is not installed: {suggest_install('view')}")


@contextlib.contextmanager
def show_page(path: Path, say: Callable[[str], object]) -> Iterator[None]:
    """Serve a page with the newest saved policy of the run in `path` while the context is open.

    Another process serves it. `say` gets each line that it prints: the address, or why it fails.
    """
    path = path.resolve()
    command = [sys.executable, "-m", "quadwalk", "alongside", str(path)]
    page = subprocess.Popen(
        [*command, f"--runs={path.parent}"],
        stdin=subprocess.PIPE,  # closed when this process ends, even if it is killed: it ends then
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,  # Ctrl-C is for training, which saves before it ends
    )
    assert page.stdin is not None

    def listen() -> None:
        assert page.stderr is not None
        for line in page.stderr:
            if line.strip():
                say(line.strip())

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    try:
        yield
    finally:
        page.stdin.close()
        page.wait()
        listener.join(1.0)  # a browser that the page has opened may hold on to its stderr
