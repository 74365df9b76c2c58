"""Write docs/settings.md from the source of the settings: `python docs/site/settings.py`."""

import ast
import dataclasses
import functools
import inspect
import itertools
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))  # the page describes the package of this folder

from quadwalk.physics.motor import MotorConfig
from quadwalk.settings import environment, training
from quadwalk.settings.terms import Observation, Reward, Term
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks, run
from quadwalk.terrain.terrain import GroundConfig

PAGE = Path(__file__).parents[1] / "settings.md"
TASKS = ("run", *sorted(set(list_tasks()) - {"run"}))  # the default one first
GROUPS = (
    training.TrainConfig,
    training.RobotConfig,
    training.PPOConfig,
    training.DistributedConfig,
    environment.EnvConfig,
    MotorConfig,
    environment.ResetConfig,
    environment.CommandConfig,
    environment.RandomizationConfig,
    environment.BodiesConfig,
    GroundConfig,
)
HEAD = """# Settings

Every setting is a flag of `train.py`: `python train.py --ppo.entropy 0.01`. A switch that is on is
turned off by `no-`: `--ppo.no-symmetric`. The defaults below are those of the task `run`;
`python train.py TASK --help-all` shows those of another. [The terms](#rewards) of all tasks stand
side by side: rewards, observations, terminations and action maps. `python docs/site/settings.py`
wrote this page from the source.
"""
# The kinds of terms, by their names in `EnvConfig`: a heading, and what the numbers mean.
KINDS = {
    "reward": ("Rewards", "The number is the scale of each control step. 0 leaves a term out."),
    "observation": ("Observations", "The policy and the value network see these. {noise}"),
    "critic": ("Observations of the critic", "Only the value network sees these. {noise}"),
    "termination": ("Terminations", "A robot that meets one of them has fallen."),
    "action": ("Action maps", "A task has one: from actions in [-1, 1] to joint targets."),
}
NOISE = (
    "`noise` is the sensor's standard deviation at noise level 1. `history` is the number of "
    "earlier control steps that are seen too; where no row names it, it is 0."
)
ABSENT = "-"  # the task has no such term
PRESENT = "yes"  # the task has the term, which has no number


def read_comments(group: type) -> dict[str, str]:
    """Return the comments in the source of a dataclass by the names of its fields."""
    source = textwrap.dedent(inspect.getsource(group))
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    lines = source.splitlines()
    return {
        field.target.id: find_comment(lines, field)
        for field in definition.body
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
    }


def find_comment(lines: list[str], field: ast.AnnAssign) -> str:
    """Return the comment beside a field, or else the comment in the lines above it."""
    assert field.end_lineno is not None
    comment = [lines[field.end_lineno - 1][field.end_col_offset :]]
    if "#" not in comment[0]:
        upwards = reversed(lines[: field.lineno - 1])
        comment = list(itertools.takewhile(is_comment, upwards))[::-1]
    return " ".join(line.strip().lstrip("# ") for line in comment)


def is_comment(line: str) -> bool:
    """Return True if a line of source holds only a comment."""
    return line.lstrip().startswith("#")


def read_summary(described: Any) -> str:
    """Return the first line of a docstring."""
    return (inspect.getdoc(described) or "").partition("\n")[0]


def format_flag(*names: str) -> str:
    """Return the flag of a setting from the names that lead to it; empty names are left out."""
    return "--" + ".".join(filter(None, names)).replace("_", "-")


def format_row(cells: Sequence[str]) -> str:
    """Return a row of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def format_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown from the names of its columns and the cells of its rows."""
    rule = f"|{'---|' * len(columns)}"
    return "\n".join([format_row(columns), rule, *map(format_row, rows)])


def replace_bars(text: str) -> str:
    """Return the text of a cell without bars, which would end the cell."""
    return text.replace("|", "or")


def format_group(group: Any) -> str:
    """Return the heading, the summary and the table of one group's settings."""
    comments = read_comments(group)
    rows = [
        (f"`{format_flag(group.group, name)}`", format_default(value), replace_bars(comments[name]))
        for name, value in collect_defaults(group).items()
    ]
    table = format_table(("flag", "default", "meaning"), rows)
    return f"## {group.group or 'train'}\n\n{read_summary(group)}\n\n{table}"


def collect_defaults(group: Any) -> dict[str, Any]:
    """Return the values of a group's settings in the task `run`, by name."""
    settings = functools.reduce(getattr, filter(None, group.group.split(".")), run.TASK)
    values = {field.name: getattr(settings, field.name) for field in dataclasses.fields(group)}
    return {name: value for name, value in values.items() if is_in_table(name, value)}


def is_in_table(name: str, value: Any) -> bool:
    """Return True if a field is a setting of its group's table."""
    if dataclasses.is_dataclass(value) or isinstance(value, dict):  # it has a table of its own
        return False
    # The task is the command's first word. The action map is among the terms.
    return name not in ("task", "action")


def format_default(value: Any) -> str:
    """Return a default as a user types it."""
    if isinstance(value, tuple):
        return " ".join(map(format_default, value)) or "none"
    return value.name if isinstance(value, Path) else str(value)


def format_terms(kind: str) -> str:
    """Return the heading, the explanation and the table of all tasks' terms of one kind."""
    heading, explanation = KINDS[kind]
    label = "term" if kind in ("termination", "action") else "flag"
    rows = [
        row
        for (name, _), terms in collect_terms(kind).items()
        for row in list_term_rows(kind, name, terms)
    ]
    lines = textwrap.fill(explanation.format(noise=NOISE), 100)
    return f"## {heading}\n\n{lines}\n\n{format_table((label, *TASKS, 'meaning'), rows)}"


def collect_terms(kind: str) -> dict[tuple[str, Any], dict[str, Term]]:
    """Return the terms of a kind in all tasks, by name and function, then by task."""
    collected: dict[tuple[str, Any], dict[str, Term]] = {}
    for task in TASKS:
        terms = getattr(load_task(task).env, kind)
        if kind == "action":  # a single term, without a name
            terms = {terms.function.__name__: terms}
        for name, term in terms.items():
            collected.setdefault((name, term.function), {})[task] = term
    return collected


def list_term_rows(kind: str, name: str, terms: dict[str, Term]) -> list[list[str]]:
    """Return the cells of one term's rows: a row for each number, a column for each task."""
    numbers = collect_numbers(terms)
    first, *others = numbers
    function = next(iter(terms.values())).function
    meanings = {first: replace_bars(read_summary(function))}
    meanings |= {number: f"`{number}` of `{name}`" for number in others}
    return [
        [
            f"`{format_term_label(kind, name, number, values)}`",
            *(format_number(values.get(task, ABSENT)) for task in TASKS),
            meanings[number],
        ]
        for number, values in numbers.items()
    ]


def collect_numbers(terms: dict[str, Term]) -> dict[str, dict[str, Any]]:
    """Return the numbers of one term, by name and task, without a history that is 0 in all."""
    numbers_by_task = {task: list_numbers(term) for task, term in terms.items()}
    collected = {}
    for name in next(iter(numbers_by_task.values())):
        values = {task: numbers[name] for task, numbers in numbers_by_task.items()}
        if name != "history" or any(values.values()):
            collected[name] = values
    return collected


def list_numbers(term: Term) -> dict[str, Any]:
    """Return the numbers of a term by the end of their flags; "" is that of the term itself."""
    match term:
        case Reward():
            numbers: dict[str, Any] = {"": term.scale}
        case Observation():
            numbers = {"noise": term.noise, "history": term.history}
        case _:
            numbers = {"": PRESENT}
    return numbers | (term.params or {})


def format_term_label(kind: str, name: str, number: str, values: dict[str, Any]) -> str:
    """Return the flag of a term's number, or the name of a term that has no number."""
    if set(values.values()) == {PRESENT}:
        return name
    # A task has one action map, so the flags of its numbers do not name it.
    term = "" if kind == "action" and number else name
    return format_flag("env", kind, term, number)


def format_number(value: Any) -> str:
    """Return a term's number without digits of no use."""
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def format_page() -> str:
    """Return the whole page."""
    return (
        "\n\n".join([HEAD.rstrip(), *map(format_group, GROUPS), *map(format_terms, KINDS)]) + "\n"
    )


if __name__ == "__main__":
    PAGE.write_text(format_page())
    print(f"wrote {PAGE}")
