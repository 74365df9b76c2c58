"""Finding tasks: those of the package by name, a user's own by the path of its file.

A task file is Python that defines `TASK`, a `TrainConfig`, and any functions that its terms need.
A run keeps a copy of it as `task.py`. Files name a term by its registered name, "reward:energy",
or by "task.py:my_term" where its function is the file's own.
"""

import hashlib
import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from quadwalk.cli.arguments import ArgumentParser
from quadwalk.errors import UsageError, UserError, line_in, meant
from quadwalk.files import os_reason, real_path
from quadwalk.settings.registry import TERMS, find_registered_name, to_current_name
from quadwalk.settings.training import TrainConfig

OWN = "task.py"  # the copy of its task's file that a run keeps
_PACKAGE = "quadwalk.tasks"
_OWN_MODULE = "quadwalk_task_file_"


def main(args: Sequence[str], prog: str = "quadwalk tasks") -> None:
    """Print a line for each task."""
    ArgumentParser(prog=prog, description="List the tasks.").parse_args(args)
    print(task_table())


def task_names() -> tuple[str, ...]:
    """The names of the package's tasks."""
    package = importlib.import_module(_PACKAGE)
    return tuple(module.name for module in pkgutil.iter_modules(package.__path__))


def task_list() -> str:
    """A line for each of the package's tasks: the first of its file's docstring."""
    modules = [importlib.import_module(f"{_PACKAGE}.{name}") for name in task_names()]
    return "\n\n".join((module.__doc__ or "").partition("\n")[0] for module in modules)


def task_table() -> str:
    """As `task_list`, in columns, for a terminal."""
    rows = (line.split(": ", 1) for line in task_list().split("\n\n"))
    return "\n".join(f"  {name:<10} {what}" for name, what in rows)


def load_task(which: str | Path) -> TrainConfig:
    """The task of this name or in this file; `UsageError` says what is wrong with it."""
    if str(which) in task_names():
        return importlib.import_module(f"{_PACKAGE}.{which}").TASK
    if Path(which).suffix != ".py":
        raise UsageError(
            f"no task {str(which)!r}; expected one of: {', '.join(task_names())}, or the path of "
            f"a .py file that defines TASK{meant(str(which), task_names())}"
        )
    task = getattr(_import(Path(which)), "TASK", None)
    if not isinstance(task, TrainConfig):
        raise UsageError(f"{which} does not define TASK; expected a quadwalk TrainConfig")
    return task


def reference(function: Callable[..., Any]) -> str:
    """Return the name by which files call a term's function.

    Raises `UsageError` where the function could not be found again by a name.
    """
    module, name = function.__module__, function.__qualname__
    if module.startswith(_OWN_MODULE) and name.isidentifier():
        return f"{OWN}:{name}"
    registered = find_registered_name(f"{module}:{name}")
    if registered is None:
        raise UsageError(
            f"the function {name} of a term is defined in {module}; expected one of the terms in "
            "quadwalk/settings/registry.py or, by a name of its own, one in a task's file, so that "
            "the run can be evaluated and resumed"
        )
    return registered


def resolve(where: str, folder: Path) -> Callable[..., Any]:
    """Return the function that `reference` of this or an earlier version named.

    `folder` is the run's, which has the task's file. Raises `UserError` where there is none.
    """
    module, _, name = where.partition(":")
    if module == OWN:
        function = getattr(_import(folder / OWN), name, None)
        if not callable(function):
            raise UserError(f"{module} has no function {name!r} (any more)")
        return function
    place = TERMS.get(to_current_name(where))
    if place is None:
        raise UserError(f"{where!r} is no term of this version of quadwalk or of {OWN}")
    module, _, name = place.partition(":")
    term: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return term


def own_file(functions: list[Callable[..., Any]]) -> bytes | None:
    """The file that holds those of the functions that are a user's own; None if none is."""
    modules = {f.__module__ for f in functions if f.__module__.startswith(_OWN_MODULE)}
    if len(modules) > 1:
        files = ", ".join(str(sys.modules[module].__file__) for module in sorted(modules))
        raise UsageError(f"the task has functions of several files, {files}; expected one")
    return sys.modules[modules.pop()].__source__ if modules else None  # type: ignore[attr-defined]


def _import(path: Path) -> ModuleType:
    """Run a task's file as a module; the same content from the same place is run once."""
    path = real_path(path)
    try:
        source = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read the task {path}: {os_reason(error)}") from None
    name = _OWN_MODULE + hashlib.sha256(bytes(path) + source).hexdigest()[:12]
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    module.__source__ = source  # type: ignore[attr-defined]
    sys.modules[name] = module
    try:
        exec(compile(source, path, "exec"), module.__dict__)
    except BaseException as error:
        del sys.modules[name]
        if not isinstance(error, Exception | SystemExit):
            raise
        line, kind = line_in(str(path), error), type(error).__name__
        said = " ".join(f"{error}".split())
        where = f"{path}, line {line}" if line else f"{path}"
        said = said if isinstance(error, UserError) else f"{kind}: {said}"
        raise UsageError(f"{where}: {said}") from None
    return module
