"""What trains with the present numbers of a desk from nothing: a command line, or a task file."""

import dataclasses
import functools
import itertools
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from quadwalk.cli.shell import make_command
from quadwalk.errors import UserError
from quadwalk.runs.directory import Run
from quadwalk.settings.registry import TERMS, get_term_name
from quadwalk.settings.serialize import find_task_source, flatten
from quadwalk.settings.terms import Reward, Term
from quadwalk.settings.training import TrainConfig, set_files
from quadwalk.task_files import TASK_FILE, load_task
from quadwalk.tasks import list_tasks

# Settings of how and where a run is trained, not of what it computes.
_RUN = ("task", "name", "runs", "minutes", "quiet", "log", "watch", "desk", "replay", "distributed")
_MACHINE = ("seed", "envs", "devices", "init")  # a task leaves them open
_REWARD = "reward:"  # before a reward's name in the registry
_FIRST_LINE = "# The numbers of the desk."


@functools.cache
def load_packaged_terms() -> dict[str, Reward]:
    """Return the rewards of the package by their names there, as a packaged task uses each."""
    used: dict[str, Reward] = {}
    for task in list_tasks():
        for term in load_task(task).env.reward.values():
            used.setdefault(get_term_name(term.function).removeprefix(_REWARD), term)
    names = (name.removeprefix(_REWARD) for name in TERMS)
    return {name: used[name] for name in names if name in used}


def list_available_terms(config: TrainConfig) -> dict[str, Reward]:
    """Return the rewards of the package that a task does not have, by the names to add them by."""
    reward = config.env.reward
    functions = [term.function for term in reward.values()]
    return {
        name: term
        for name, term in load_packaged_terms().items()
        if name not in reward and term.function not in functions
    }


def format_flags(config: TrainConfig, run: Run) -> str:
    """Return the command line that trains as `config` says; `UserError` where none can."""
    base, task = find_base(config, run)
    before, now = flatten(_leave_out(base, _RUN)), flatten(_leave_out(config, _RUN))
    if added := [name for name in config.env.reward if name not in base.env.reward]:
        raise UserError(
            f"no flag adds a term to {task}, and {', '.join(added)} was added: save a task file"
        )
    flags = [_format_flag(name, value) for name, value in now.items() if value != before[name]]
    return make_command("train", task, *itertools.chain(*flags))


def format_task(config: TrainConfig, run: Run, name: str) -> str:
    """Return a task file, of the task `name`, that trains as `config` says."""
    base, _ = find_base(config, run)
    old, new = _leave_out(base, (*_RUN, *_MACHINE)), _leave_out(config, (*_RUN, *_MACHINE))
    source = find_task_source(config)
    base_name = f"{config.task}.TASK" if source is None else "TASK"
    task = f"TASK = {_format_changes(old, new, base_name, name)}"
    imports = ["import dataclasses"]
    if "Path(" in task:
        imports.append("from pathlib import Path")
    modules = ["blog"] if "Reward(blog." in task else []
    modules += [] if source else [config.task]
    if modules:
        imports.append(f"\nfrom quadwalk.tasks import {', '.join(sorted({*modules}))}")
    if "Reward(" in task:
        imports.append("from quadwalk.terms import Reward, rewards")
    if source is None:
        head = f'"""{name}: {config.task} with the numbers of the desk."""\n'
    else:
        head = f"{source.decode().rstrip()}\n\n\n{_FIRST_LINE}"
    return "\n".join([head, *imports, "", task])


def find_base(config: TrainConfig, run: Run) -> tuple[TrainConfig, str]:
    """Return the task that a run was started from, and its name or the path of its file."""
    if find_task_source(config) is not None:
        task = str(run.path / TASK_FILE)
    elif config.task in list_tasks():
        task = config.task
    else:
        raise UserError(f"the task {config.task!r} is in no file; expected one of the package")
    base = load_task(task)
    robot = base.robot
    return set_files(base, robot.urdf, robot.mesh_dirs, base.env.ground.file), task


def _leave_out(config: TrainConfig, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        field.name: getattr(config, field.name)
        for field in dataclasses.fields(config)
        if field.name not in names
    }


def _format_flag(name: str, value: Any) -> list[str]:
    """Return the words that set a setting."""
    group, _, last = name.replace("_", "-").rpartition(".")
    prefix = f"--{group}." if group else "--"
    if isinstance(value, bool):
        return [f"{prefix}{'' if value else 'no-'}{last}"]
    if isinstance(value, tuple):
        return [f"{prefix}{last}", *map(_format_number, value)]
    return [f"{prefix}{last}={_format_number(value)}"]


def _format_number(value: Any) -> str:
    """Return a number without an exponent, which after a dash would look like a flag."""
    if isinstance(value, float):
        return str(np.format_float_positional(value, trim="0"))
    return str(value)


def _format_changes(old: dict[str, Any], new: dict[str, Any], expression: str, task: str) -> str:
    """Return Python for the task `expression` with the settings `new` in place of `old`."""
    parts = [
        f"{name}={_format(old[name], value, f'{expression}.{name}')}"
        for name, value in new.items()
        if value != old[name]
    ]
    return _call("dataclasses.replace", [expression, f'task="{task}"', *parts]) + "\n"


def _format(old: Any, new: Any, expression: str) -> str:
    """Return Python for `new`, where `expression` is Python for `old`."""
    if isinstance(new, dict) and isinstance(old, dict):
        parts = [f"**{expression}"]
        for name, value in new.items():
            if name not in old:
                parts.append(f'"{name}": {_format_term(value)}')
            elif value != old[name]:
                changed = _format(old[name], value, f'{expression}["{name}"]')
                parts.append(f'"{name}": {changed}')
        return _wrap("{", parts, "}")
    if dataclasses.is_dataclass(new) and type(new) is type(old):
        parts = [
            f"{field.name}={_format(getattr(old, field.name), value, f'{expression}.{field.name}')}"
            for field in dataclasses.fields(new)
            if (value := getattr(new, field.name)) != getattr(old, field.name)
        ]
        return _call("dataclasses.replace", [expression, *parts])
    return _format_value(new)


def _format_term(term: Term) -> str:
    assert isinstance(term, Reward)
    module = term.function.__module__.rpartition(".")[2]
    params = [repr(term.params)] if term.params else []
    return _call("Reward", [f"{module}.{term.function.__name__}", *params, f"scale={term.scale}"])


def _format_value(value: Any) -> str:
    if isinstance(value, Path):
        return f"Path({str(value)!r})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_format_value, value))}{',' * (len(value) == 1)})"
    return repr(value)


def _call(function: str, arguments: list[str]) -> str:
    return _wrap(f"{function}(", arguments, ")")


def _wrap(start: str, parts: list[str], end: str) -> str:
    """Return the parts on one line, or each on a line of its own where they are long."""
    line = f"{start}{', '.join(parts)}{end}"
    if len(line) <= 70 and "\n" not in line:
        return line
    lines = textwrap.indent("".join(f"{part},\n" for part in parts), "    ")
    return f"{start}\n{lines}{end}"
