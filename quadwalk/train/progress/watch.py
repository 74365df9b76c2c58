"""A page in which the newest policy of a training is seen live, from a process of its own."""

import contextlib
import importlib.util
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

from quadwalk.errors import UserError
from quadwalk.train.runs.directory import Run

WATCHED = 20  # times that the policy is saved for the page between two checkpoints


def check_watch() -> None:
    """Raise `UserError` in one line where the page cannot be shown."""
    if importlib.util.find_spec("mjviser") is None:
        raise UserError(
            "--watch needs mjviser, which is not installed: pip install 'quadwalk[view]'"
        )


@contextlib.contextmanager
def watched(run: Run, say: Callable[[str], object]) -> Iterator[None]:
    """The page of `run`, which takes each policy that is saved; `say` is told where it is."""
    path, runs = run.path.resolve(), run.path.resolve().parent
    command = [sys.executable, "-m", "quadwalk.view", str(path), "--browser", f"--runs={runs}"]
    page = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)

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
        page.terminate()
        page.wait()
        listener.join()
