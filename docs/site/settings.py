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
from quadwalk.tasks import run
from quadwalk.terrain.terrain import GroundConfig

PAGE = Path(__file__).parents[1] / "settings.md"
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
    GroundConfig,
)
HEAD = """# Settings

Every setting is a flag of `train.py`: `python train.py --ppo.entropy 0.01`. A switch that is on is
turned off by `no-`: `--ppo.no-symmetric`. The defaults below are those of the task `run`;
`python train.py TASK --help-all` shows those of another. `python docs/site/settings.py` wrote this
page from the source.
"""


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


def page() -> str:
    """The whole page."""
    return "\n\n".join([HEAD.rstrip(), *map(table, GROUPS)]) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"wrote {PAGE}")
