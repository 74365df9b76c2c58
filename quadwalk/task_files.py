"""Finding tasks: those of the package by name, a user's own by the path of its file.

A task file is Python that defines `TASK`, a `TrainConfig`, and any functions that its terms need.
A run keeps a copy of it as `task.py`.
"""

import hashlib
import importlib
import importlib.util
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from quadwalk.errors import UsageError, UserError, find_line, suggest
from quadwalk.files import get_os_reason, resolve_path
from quadwalk.settings.training import TrainConfig
from quadwalk.tasks import list_tasks

TASK_FILE = "task.py"  # the copy of its task's file that a run keeps
_MODULE = "quadwalk_task_file_"  # how the module of a task file is called in this process
# Modules that task files of version 0.2 import. Version 0.4 leaves this table out.
_MOVED = {
    "quadwalk.task.reflections": "quadwalk.terms",
    "quadwalk.task import reward": "quadwalk.terms import rewards as reward",
    "quadwalk.task import observation": "quadwalk.terms import observations as observation",
    "quadwalk.task import termination": "quadwalk.terms import terminations as termination",
    "quadwalk.task.reward": "quadwalk.env.rewards",
    "quadwalk.task.observation": "quadwalk.env.observations",
    "quadwalk.task.termination": "quadwalk.env.terminations",
    "quadwalk.task": "quadwalk.env",
    "quadwalk.ground": "quadwalk.terrain",
}


def load_task(task: str | Path) -> TrainConfig:
    """Return the task of this name or in this file; `UsageError` says what is wrong with it."""
    names = list_tasks()
    if str(task) in names:
        return importlib.import_module(f"quadwalk.tasks.{task}").TASK
    if Path(task).suffix != ".py":
        raise UsageError(
            f"no task {str(task)!r}; expected one of: {', '.join(names)}, or the path of "
            f"a .py file that defines TASK{suggest(str(task), names)}"
        )
    config = getattr(run_task_file(Path(task)), "TASK", None)
    if not isinstance(config, TrainConfig):
        raise UsageError(f"{task} does not define TASK; expected a quadwalk TrainConfig")
    return config


def is_from_task_file(function: Callable[..., Any]) -> bool:
    """Return True if a user's task file defines the function, and not quadwalk itself."""
    return function.__module__.startswith(_MODULE)


def get_source(function: Callable[..., Any]) -> bytes:
    """Return the content of the task file that defines the function."""
    source: bytes = sys.modules[function.__module__].__source__  # type: ignore[attr-defined]
    return source


def run_task_file(path: Path) -> ModuleType:
    """Run a task's file as a module; the same content from the same place is run once."""
    path = resolve_path(path)
    try:
        source = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read the task {path}: {get_os_reason(error)}") from None
    name = _MODULE + hashlib.sha256(bytes(path) + source).hexdigest()[:12]
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    module.__source__ = source  # type: ignore[attr-defined]
    sys.modules[name] = module
    try:
        exec(compile(_update_imports(path, source), path, "exec"), module.__dict__)
    except BaseException as error:
        del sys.modules[name]
        if not isinstance(error, Exception | SystemExit):
            raise
        line, kind = find_line(str(path), error), type(error).__name__
        reason = " ".join(f"{error}".split())
        place = f"{path}, line {line}" if line else f"{path}"
        reason = reason if isinstance(error, UserError) else f"{kind}: {reason}"
        raise UsageError(f"{place}: {reason}") from None
    return module


def _update_imports(path: Path, source: bytes) -> bytes:
    """Return a task file's source with today's names of modules; print a line if any has moved."""
    moves = []
    for old, new in _MOVED.items():
        updated = re.sub(rf"\b{old}\b".encode(), new.encode(), source)
        if updated != source:
            moves.append(f"{old} is now {new}")
        source = updated
    if moves:
        print(f"warning: {path}: {', '.join(moves)}; version 0.4 reads no others", file=sys.stderr)
    return source
