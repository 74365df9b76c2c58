"""`python docs/site/settings.py`: write docs/settings.md from the settings' own source."""

import ast
import dataclasses
import inspect
import sys
import textwrap
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))  # the package beside which it stands

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
# Of each kind of terms: its place in `EnvConfig`, its heading, and what the numbers are.
KINDS = {
    "reward": ("Rewards", "The number is the scale. A term with scale 0 is left out."),
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


def comments(group: type) -> dict[str, str]:
    """What the source says of each field: the comment beside it, or those in the lines above."""
    source = textwrap.dedent(inspect.getsource(group))
    lines = source.splitlines()
    found = {}
    (tree,) = ast.parse(source).body
    assert isinstance(tree, ast.ClassDef)
    for node in tree.body:
        if not isinstance(node, ast.AnnAssign) or not isinstance(node.target, ast.Name):
            continue
        assert node.end_lineno is not None
        beside = lines[node.end_lineno - 1][node.end_col_offset :]
        above: list[str] = []
        for line in reversed(lines[: node.lineno - 1]):
            if not line.lstrip().startswith("#"):
                break
            above.insert(0, line)
        said = [beside] if "#" in beside else above
        found[node.target.id] = " ".join(line.strip().lstrip("# ") for line in said)
    return found


def text(value: Any) -> str:
    """A default as it is typed."""
    if isinstance(value, tuple):
        return " ".join(map(text, value)) or "none"
    return value.name if isinstance(value, Path) else str(value)


def table(group: Any) -> str:
    """The heading and the rows of one group's settings."""
    value: Any = run.TASK
    for part in filter(None, group.group.split(".")):
        value = getattr(value, part)
    said, rows = comments(group), []
    for field in dataclasses.fields(group):
        default = getattr(value, field.name)
        if dataclasses.is_dataclass(default) or isinstance(default, dict) or field.name == "task":
            continue
        if field.name == "action":  # a function
            continue
        flag = f"--{group.group}.{field.name}".replace("--.", "--").replace("_", "-")
        rows.append(f"| `{flag}` | {text(default)} | {said[field.name].replace('|', 'or')} |")
    summary = (inspect.getdoc(group) or "").partition("\n")[0]
    head = (
        f"## {group.group or 'train'}\n\n{summary}\n\n| flag | default | meaning |\n|---|---|---|\n"
    )
    return head + "\n".join(rows)


def collect_terms(kind: str) -> dict[tuple[str, Any], dict[str, Term]]:
    """Return the terms of a kind in all tasks, by name and function, then by task."""
    collected: dict[tuple[str, Any], dict[str, Term]] = {}
    for task in TASKS:
        terms = getattr(load_task(task).env, kind)
        if kind == "action":
            terms = {terms.function.__name__: terms}
        for name, term in terms.items():
            collected.setdefault((name, term.function), {})[task] = term
    return collected


def list_numbers(term: Term) -> dict[str, Any]:
    """Return the numbers of a term by the end of their flags; "" is that of the term itself."""
    match term:
        case Reward():
            first: dict[str, Any] = {"": term.scale}
        case Observation():
            first = {".noise": term.noise, ".history": term.history}
        case _:
            first = {"": "yes"}  # no flag: the task has it
    return first | {f".{name}": value for name, value in (term.params or {}).items()}


def write_term_rows(kind: str, name: str, terms: dict[str, Term]) -> list[str]:
    """Return a table's rows for one term, which has other numbers in each task."""
    numbers = {task: list_numbers(term) for task, term in terms.items()}
    (first, *others) = next(iter(numbers.values()))
    meaning = (inspect.getdoc(next(iter(terms.values())).function) or "").partition("\n")[0]
    rows = []
    for end in (first, *others):
        values = {task: of_task[end] for task, of_task in numbers.items()}
        if end == ".history" and not any(values.values()):
            continue
        flag = f"--env.{kind}" + ("" if kind == "action" and end else f".{name}") + end
        flag = name if set(values.values()) == {"yes"} else flag.replace("_", "-")
        words = meaning.replace("|", "or") if end == first else f"`{end[1:]}` of `{name}`"
        cells = [format_number(values.get(task, ABSENT)) for task in TASKS]
        rows.append(f"| `{flag}` | {' | '.join(cells)} | {words} |")
    return rows


def format_number(value: Any) -> str:
    """Return a term's number without digits of no use."""
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def write_terms(kind: str) -> str:
    """Return the heading and the table of all tasks' terms of one kind."""
    heading, text_above = KINDS[kind]
    columns = ["term" if kind in ("termination", "action") else "flag", *TASKS, "meaning"]
    head = f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}\n"
    terms = collect_terms(kind)
    rows = [row for (name, _), tasks in terms.items() for row in write_term_rows(kind, name, tasks)]
    lines = textwrap.fill(text_above.format(noise=NOISE), 100)
    return f"## {heading}\n\n{lines}\n\n{head}" + "\n".join(rows)


def page() -> str:
    """The whole page."""
    return "\n\n".join([HEAD.rstrip(), *map(table, GROUPS), *map(write_terms, KINDS)]) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"wrote {PAGE}")
