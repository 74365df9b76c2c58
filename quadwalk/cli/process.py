"""A command line as a process: its packages, its standard streams, and how it ends."""

from __future__ import annotations

import contextlib
import errno
import gc
import importlib
import importlib.util
import io
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from quadwalk.cli.shell import ROOT, install, short, words
from quadwalk.errors import UserError
from quadwalk.files import os_reason, remove_unfinished

# What quadwalk imports.
_PACKAGES = (
    "PIL", "brax", "foxglove_schemas_protobuf", "google", "jax", "lxml", "matplotlib", "mcap",
    "mcap_protobuf", "mujoco", "numpy", "optax", "packaging", "platformdirs", "rich", "scipy",
    "tensorboardX", "trimesh", "tyro", "yourdfpy",
)  # fmt: skip
_AGAIN = "QUADWALK_AGAIN"  # set where a process begins again with the interpreter in .venv
_GRACE = 2.0  # s for a command to end by itself
# Why text is not taken by a stream; files that are written name themselves.
_REFUSALS = (errno.EBADF, errno.EFBIG, errno.EIO, errno.ENOSPC, errno.EPIPE)
_ENDS: dict[int, str] = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


def run_command(main: Callable[[], object] | str) -> NoReturn:
    """Run `main`, or that of the module of this name, and end the process with its exit status.

    A `UserError` is one line on stderr. Ctrl-C and SIGTERM raise `KeyboardInterrupt`, and end the
    process after a grace where that has no effect, as in a compiler, which no exception reaches.
    A module is named, rather than imported before, so that importing it can be ended too.
    """
    _open_streams()
    # What is imported and traced stays: to look for garbage there takes a tenth of a start.
    gc.set_threshold(100_000)
    with _endable() as signals:
        status = _status(main, signals)
        try:
            sys.stdout.flush()  # only now a full disk may refuse what was printed
        except OSError as error:
            status = _refused(error)
    # CPython remembers an interrupt that left an `exec`, as of an import, and would end itself by
    # the signal instead of this status. Another `exec` makes it forget.
    exec("")
    sys.exit(status)


def _status(main: Callable[[], object] | str, signals: list[int]) -> Any:
    """Run `main`; the exit status."""
    try:
        _find_packages()
        (importlib.import_module(main).main if isinstance(main, str) else main)()
        return 0
    except SystemExit as stop:  # of --help
        return stop.code
    except BaseException as error:
        # Libraries may turn an interruption into an error of theirs.
        if signals or isinstance(error, KeyboardInterrupt):
            number = signals[0] if signals else signal.SIGINT
            _say(_ENDS[number])
            return 128 + number
        if isinstance(error, UserError):
            _say(f"error: {error}")
            return error.exit_status
        if isinstance(error, OSError) and error.errno in _REFUSALS and not error.filename:
            return _refused(error)
        raise


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _refused(error: OSError) -> int:
    """Say why standard output could not be written; the exit status."""
    # Python would try once more at its end, and complain.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if not isinstance(error, BrokenPipeError):
        _say(f"error: cannot write to standard output: {os_reason(error)}")
    return 1


class _Stderr(io.FileIO):
    """Standard error, where a failed write does not end the process."""

    def write(self, data: Any) -> int:
        with contextlib.suppress(OSError):
            return super().write(data)
        return len(data)


def _open_streams() -> None:
    """Give streams that are closed a file, and let all write what their encoding lacks as "?"."""
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            # It gets the number of the stream, which a file that is written would have otherwise.
            # Standard output that was closed refuses text: it is open for reading.
            way = os.O_WRONLY if name == "stderr" else os.O_RDONLY
            stream = open(os.open(os.devnull, way), "r" if name == "stdin" else "w")  # noqa: SIM115
            setattr(sys, name, stream)
        if name == "stdout" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    raw, encoding = _Stderr(sys.stderr.fileno(), "w", closefd=False), sys.stderr.encoding
    sys.stderr = io.TextIOWrapper(io.BufferedWriter(raw), encoding, "replace", line_buffering=True)


def _find_packages() -> None:
    """Begin again with the interpreter in .venv where this one lacks packages, or say so."""
    again = os.environ.pop(_AGAIN, None)
    missing = [name for name in _PACKAGES if importlib.util.find_spec(name) is None]
    if not missing:
        return
    python = ROOT / ".venv" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if again is None and python.exists():
        given = getattr(sys, "orig_argv", [sys.executable, *sys.argv])  # from Python 3.10 on
        command, environment = [str(python), *given[1:]], {**os.environ, _AGAIN: "1"}
        with contextlib.suppress(OSError):
            if os.name != "nt":
                os.execve(python, command, environment)
            sys.exit(subprocess.run(command, env=environment).returncode)
    folder = [] if Path.cwd() == ROOT else ["-C", short(str(ROOT))]
    make = f"{words('make', *folder, 'setup')}, or: " if (ROOT / "Makefile").exists() else ""
    raise UserError(f"{missing[0]} is not installed; get what is needed by: {make}{install()}")


@contextlib.contextmanager
def _endable() -> Iterator[list[int]]:
    """Have Ctrl-C and SIGTERM end what the process does in here; yields the signals that came."""
    came: list[int] = []
    ignored = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        came.append(number)
        if _loading_extension(frame):
            ignored.set()
        else:
            raise KeyboardInterrupt

    def unraisable(args: Any) -> None:
        if issubclass(args.exc_type, KeyboardInterrupt):
            ignored.set()
        else:
            sys.__unraisablehook__(args)

    inbox, outbox = socket.socketpair()
    outbox.setblocking(False)
    for number in _ENDS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handle)
    signal.set_wakeup_fd(outbox.fileno(), warn_on_full_buffer=False)
    sys.unraisablehook = unraisable
    threading.Thread(target=_watch, args=(inbox, handle, ignored), daemon=True).start()
    try:
        yield came
    finally:
        for number in _ENDS:
            if signal.getsignal(number) is handle:
                signal.signal(number, signal.SIG_DFL)  # from here on nothing can be lost
        signal.set_wakeup_fd(-1)


def _loading_extension(frame: FrameType | None) -> bool:
    """Whether a compiled module is being imported: one in C++ may abort where that raises."""
    while frame is not None and not frame.f_code.co_qualname.startswith("ExtensionFileLoader."):
        frame = frame.f_back
    return frame is not None


def _watch(inbox: socket.socket, handle: Callable[..., None], ignored: threading.Event) -> None:
    """End the process if it goes on after a signal that is to end it; for a thread of its own.

    The system's own handler sends every signal to `inbox`, whatever Python is doing. One that has
    another handler than `handle`, as while training, counts when it comes for the second time.
    """
    seen, main = set(), threading.main_thread().ident
    assert main is not None
    while True:
        number = int.from_bytes(inbox.recv(1), "big")
        if not number:  # the other end is closed: the command is over
            return
        if number in _ENDS and (signal.getsignal(number) is handle or number in seen):
            break
        seen.add(number)
    if number == signal.SIGTERM:  # Ctrl-C children have had as well
        for child in multiprocessing.active_children():
            child.terminate()
    inbox.setblocking(False)
    raised, end = False, time.monotonic() + _GRACE
    while time.monotonic() < end:
        time.sleep(0.1)
        more = b""
        with contextlib.suppress(BlockingIOError):
            more = inbox.recv(100)[raised:]
        # Those that train save what they have first, unless a signal comes again.
        for child in multiprocessing.active_children():
            end = time.monotonic() + _GRACE
            if more:
                child.kill()
        # Python ignores what is raised in a callback, as that of the garbage collector, and
        # `handle` raises nothing in the import of a compiled module: the signal is sent again.
        over = signal.getsignal(number) is signal.SIG_DFL
        raised = ignored.is_set() and not over and hasattr(signal, "pthread_kill")
        if raised:
            ignored.clear()
            signal.pthread_kill(main, number)
    remove_unfinished()
    for descriptor in (1, 2):
        if os.isatty(descriptor):
            os.write(descriptor, b"\x1b[?25h\n")  # a live view hides the cursor
    if signal.getsignal(number) is not signal.SIG_DFL:  # else the command's end has said it
        _say(_ENDS[number])
    os._exit(128 + number)
