"""How a command starts and ends: its interpreter, its messages, and its exit status."""

from __future__ import annotations

import errno
import gc
import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from quadwalk.cli.shell import ROOT, quote_words, shorten_path, suggest_install
from quadwalk.errors import UserError

_INTERRUPTED = 130  # the exit status that shells give Ctrl-C
_CURSOR = b"\x1b[?25h"  # shows a terminal's cursor, which a live view hides
# Why a stream refuses text; an error about a file names the file.
_REFUSALS = (errno.EBADF, errno.ENOSPC, errno.EPIPE)


def run_command(main: Callable[[], object]) -> NoReturn:
    """Run `main` and end the process with its exit status.

    A `UserError` is one line on standard error. Ctrl-C and SIGTERM raise `KeyboardInterrupt`: one
    line, "interrupted", and status 130. Python does so when a call of a library returns; the next
    signal ends the process at once.
    """
    sys.exit(_run(main))


def _run(main: Callable[[], object]) -> Any:
    """Run `main`, print its errors as `run_command` says, and return the exit status."""
    signals: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        _end_at_signals()
        if os.isatty(2):
            os.write(2, _CURSOR)
        if hasattr(signal, "setitimer"):  # not on Windows
            signal.signal(signal.SIGALRM, interrupt_again)
            signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
        raise KeyboardInterrupt

    def interrupt_again(number: int, frame: FrameType | None) -> None:
        """Interrupt what goes on: trimesh, or Python in a callback, caught the error."""
        if not isinstance(sys.exception(), KeyboardInterrupt):  # else something closes its files
            raise KeyboardInterrupt

    def report_ignored(unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(unraisable)

    sys.unraisablehook = report_ignored
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, interrupt)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # what the encoding lacks becomes "?"
    # What is imported and traced stays: to look for garbage there takes a tenth of a start.
    gc.set_threshold(100_000)
    try:
        try:
            _restart_with_packages()
            main()
            if sys.stdout is not None:
                sys.stdout.flush()  # only now a full disk may refuse what was printed
        finally:
            if hasattr(signal, "setitimer"):
                signal.setitimer(signal.ITIMER_REAL, 0.0)  # nothing of the command goes on
        return 0
    except SystemExit as stop:  # of --help
        return stop.code
    except BaseException as error:
        if signals or isinstance(error, KeyboardInterrupt):  # a library may raise another error
            return _fail("interrupted", _INTERRUPTED)
        if isinstance(error, UserError):
            return _fail(f"error: {error}", error.exit_status)
        if isinstance(error, OSError) and error.errno in _REFUSALS and not error.filename:
            return _end_output(error)
        raise
    finally:
        _end_at_signals()


def _end_at_signals() -> None:
    """Give Ctrl-C and SIGTERM back to the system, which ends the process at the next one."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


def _fail(message: str, status: int) -> int:
    """Print why the command ends to standard error; return `status`."""
    print(message, file=sys.stderr)
    return status


def _end_output(error: OSError) -> int:
    """Print why standard output takes no more; return the exit status."""
    # Python would try to write the rest when it ends, and complain.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return 1
    return _fail(f"error: cannot write to standard output: {error.strerror}", 1)


def _restart_with_packages() -> None:
    """Start again with the interpreter in .venv if this one lacks packages.

    Without such an interpreter raise a `UserError` that says how to install them.
    """
    missing = [name for name in ("jax", "mujoco", "tyro") if not importlib.util.find_spec(name)]
    if not missing:
        return
    environment = ROOT / ".venv"
    python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if python.exists() and Path(sys.prefix).resolve() != environment.resolve():
        words_typed = getattr(sys, "orig_argv", [sys.executable, *sys.argv])  # from Python 3.10 on
        command = [str(python), *words_typed[1:]]
        if os.name == "nt":
            sys.exit(subprocess.run(command).returncode)
        os.execv(python, command)
    folder = [] if Path.cwd() == ROOT else ["-C", shorten_path(str(ROOT))]
    make = f"{quote_words('make', *folder, 'setup')}, or: " if (ROOT / "Makefile").exists() else ""
    raise UserError(
        f"{missing[0]} is not installed; get what is needed by: {make}{suggest_install()}"
    )
