"""Commands to paste into the shell that this process was called from."""

from __future__ import annotations

import importlib
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from quadwalk.errors import UserError

ROOT = Path(__file__).parents[2]  # of a checkout: where train.py, eval.py and .venv are


def quote_words(*command: str | Path) -> str:
    """Return a command with every word quoted as the shell needs it."""
    texts = [str(word) for word in command]
    return subprocess.list2cmdline(texts) if os.name == "nt" else shlex.join(texts)


def get_python() -> str:
    """Return how the shell calls this process's interpreter: by its name if it is on the PATH.

    Otherwise it is the path of the interpreter.
    """
    return _name_program(sys.executable)


def find_program(name: str) -> str:
    """Return how the shell calls a program that pip installs for this Python.

    It stands beside the interpreter, also where it is not installed yet; by its name if only the
    PATH has one.
    """
    beside = str(Path(sys.executable).with_name(name))
    if shutil.which(beside) is None and shutil.which(name) is not None:
        return name
    return _name_program(beside)


def make_command(command: str, *arguments: str | Path) -> str:
    """Return a line for the shell that calls another command of quadwalk with `arguments`.

    It calls `quadwalk` if this process was called so, else the command's script or `-m quadwalk`.
    """
    called = Path(sys.argv[0] or "-")
    script = called.with_name(f"{command}.py")
    if called.stem == "quadwalk":
        return quote_words(_name_program(str(called)), command, *arguments)
    if script.exists() and script.samefile(ROOT / script.name):
        return quote_words(get_python(), script, *arguments)
    return quote_words(get_python(), "-m", "quadwalk", command, *arguments)


def suggest_install(extra: str = "") -> str:
    """Return the pip command that installs quadwalk, and `extra` if named, for this Python."""
    extra = f"[{extra}]" if extra else ""
    source = ["-e", shorten_path(str(ROOT))] if (ROOT / "pyproject.toml").exists() else ["quadwalk"]
    source[-1] += extra
    return quote_words(get_python(), "-m", "pip", "install", *source)


def import_extra(module: str, user: str, name: str) -> Any:
    """Import and return `module`, of the optional extra `name`.

    If it is not installed, raise a `UserError`: `user`, which is a flag or a command, needs it.
    Such modules are imported where they are used: not all are installed, and some take seconds.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        command = suggest_install(name)
        raise UserError(f"{user} needs {package}, which is not installed: {command}") from None


def _name_program(path: str) -> str:
    """Return how the shell calls a program: by name if the PATH leads to it, else by path."""
    name = Path(path).name
    program = shutil.which(name)
    is_on_path = program is not None and os.path.abspath(program) == os.path.abspath(path)
    return name if is_on_path else shorten_path(path)


def shorten_path(path: str) -> str:
    """Return `path` relative to the current folder if that is shorter."""
    try:
        relative = os.path.relpath(path)
    except ValueError:  # on another drive
        return path
    # Without a separator the shell would take the name of a program for one on the PATH.
    shorter = len(relative) < len(path) and (os.sep in relative or relative == ".")
    return relative if shorter else path
