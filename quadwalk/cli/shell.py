"""Commands to paste into the shell that this process was called from, and what they install."""

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


def words(*command: str | Path) -> str:
    """A command with every word quoted as the shell needs it."""
    texts = [str(word) for word in command]
    return subprocess.list2cmdline(texts) if os.name == "nt" else shlex.join(texts)


def python() -> str:
    """The interpreter of this process: its name if the shell finds it by that, else its path."""
    return _program(sys.executable)


def as_typed(command: str, *arguments: str | Path) -> str:
    """How to call another command: as `quadwalk` if this one was, else by its script or module."""
    called = Path(sys.argv[0] or "-")
    script = called.with_name(f"{command}.py")
    if called.stem == "quadwalk":
        return words(_program(str(called)), command, *arguments)
    if script.exists() and script.samefile(ROOT / script.name):
        return words(python(), script, *arguments)
    return words(python(), "-m", "quadwalk", command, *arguments)


def install(extra: str = "") -> str:
    """How to install quadwalk for this interpreter, with an extra if one is named."""
    extra = f"[{extra}]" if extra else ""
    source = ["-e", short(str(ROOT))] if (ROOT / "pyproject.toml").exists() else ["quadwalk"]
    source[-1] += extra
    return words(python(), "-m", "pip", "install", *source)


def extra(module: str, user: str, name: str) -> Any:
    """A module that comes with the extra `name`, for `user`; `UserError` where it is missing.

    Such modules are imported where they are used: not all are there, and some take seconds.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        what = module.partition(".")[0]
        raise UserError(f"{user} needs {what}, which is not installed: {install(name)}") from None


def _program(path: str) -> str:
    name = Path(path).name
    found = shutil.which(name)
    known = found is not None and os.path.abspath(found) == os.path.abspath(path)
    return name if known else short(path)


def short(path: str) -> str:
    """The path from the current folder if that is the shorter one."""
    try:
        relative = os.path.relpath(path)
    except ValueError:  # on another drive
        return path
    # Without a separator the shell would take the name of a program for one on the PATH.
    shorter = len(relative) < len(path) and (os.sep in relative or relative == ".")
    return relative if shorter else path
