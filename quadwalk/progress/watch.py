"""A page in which the newest policy of a training is seen live, from a process of its own."""

import contextlib
import importlib.util
import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from quadwalk.cli.shell import suggest_install
from quadwalk.errors import UserError

WATCHED = 20  # times that the policy is saved for the page between two checkpoints

_WAITING_LINES = 200  # to a page that is slow to read
_LAST_SECONDS = 1.0  # that the last of them may take


def check_watch() -> None:
    """Raise `UserError` where a package that the page needs is missing."""
    if importlib.util.find_spec("onnx") is None:
        raise UserError(f"--watch needs onnx, which is not installed: {suggest_install('view')}")


class Page:
    """A page's process: messages to it and from it, each a dict as a line of JSON."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._process = process
        # Lines wait here, since a training does not wait for a page that is slow to read.
        self._lines: queue.Queue[str | None] = queue.Queue(_WAITING_LINES)
        self._threads = [
            threading.Thread(target=run, daemon=True) for run in (self._write, self._read)
        ]
        for thread in self._threads:
            thread.start()

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message to all pages that are open; it is lost where too many wait."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(json.dumps(message))

    def close(self) -> None:
        """Send what waits, and close the input of the process, which ends it."""
        with contextlib.suppress(queue.Full):
            self._lines.put(None, timeout=_LAST_SECONDS)
        self._threads[0].join(_LAST_SECONDS)
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def _write(self) -> None:
        assert self._process.stdin is not None
        while (line := self._lines.get()) is not None:
            try:
                self._process.stdin.write(line + "\n")
                self._process.stdin.flush()
            except (OSError, ValueError):  # it has ended
                return

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with contextlib.suppress(ValueError):  # a browser that it opened may print here
                message = json.loads(line)
                if isinstance(message, dict):
                    self.messages.put(message)


@contextlib.contextmanager
def show_page(path: Path, say: Callable[[str], object]) -> Iterator[Page]:
    """Serve a page with the newest saved policy of the run in `path` while the context is open.

    Another process serves it. `say` gets each line that it prints: the address, or why it fails.
    """
    path = path.resolve()
    command = [sys.executable, "-m", "quadwalk", "alongside", str(path)]
    process = subprocess.Popen(
        [*command, f"--runs={path.parent}"],
        stdin=subprocess.PIPE,  # closed when this process ends, even if it is killed: it ends then
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,  # Ctrl-C is for training, which saves before it ends
    )

    def listen() -> None:
        assert process.stderr is not None
        for line in process.stderr:
            if line.strip():
                say(line.strip())

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    page = Page(process)
    try:
        yield page
    finally:
        page.close()
        process.wait()
        listener.join(1.0)  # a browser that the page has opened may hold on to its stderr
