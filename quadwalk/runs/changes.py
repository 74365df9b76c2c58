"""The changes of a training's numbers at the desk, as a run's `desk.jsonl` keeps them.

One line for each: control steps and iterations before it, the number's name, its old and its new
value. A term that was added has no old value, and as its new one the term as in config.json.
"steps", the training's length, is there too. An undo is a line that takes back the change before it
that still holds; `list_standing` leaves both out.
"""

import dataclasses
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadwalk.env.numbers import get_numbers
from quadwalk.errors import UserError
from quadwalk.files import DAMAGE, open_atomic, read_bytes
from quadwalk.runs.directory import Run
from quadwalk.settings.serialize import change_settings, flatten, from_dict
from quadwalk.settings.terms import Reward
from quadwalk.settings.training import TrainConfig

STEPS = "steps"  # the name of the training's length


@dataclass(frozen=True)
class Change:
    """A number that was changed between two iterations, or a term that was added."""

    iteration: int  # iterations done before it
    steps: int  # control steps done before it
    name: str
    old: Any  # None: a term was added
    new: Any
    undo: bool = False  # True: it takes back the last change, and training goes back to there

    @property
    def adds_term(self) -> bool:
        """True if it adds a term, which changes the program."""
        return self.old is None


def format_changes(changes: Iterable[Change]) -> bytes:
    """Return the content of desk.jsonl."""
    lines = (json.dumps(dataclasses.asdict(change)) + "\n" for change in changes)
    return "".join(lines).encode()


def write_changes(run: Run, changes: Iterable[Change]) -> None:
    """Write desk.jsonl, for good and whole or not at all; raises `UserError`."""
    with open_atomic(run.desk) as file:
        file.write(format_changes(changes))


def read_changes(run: Run) -> list[Change]:
    """Read desk.jsonl; `UserError` names a line that is damaged."""
    changes = []
    for number, line in enumerate(read_bytes(run.desk).splitlines(), 1):
        try:
            change = Change(**json.loads(line))
            change = dataclasses.replace(
                change, iteration=int(change.iteration), steps=int(change.steps)
            )
        except DAMAGE:
            raise UserError(f"{run.desk}, line {number}: expected a change as JSON") from None
        changes.append(change)
    return changes


def list_standing(changes: Iterable[Change]) -> list[Change]:
    """Return the changes that no undo has taken back, in order."""
    standing: list[Change] = []
    for change in changes:
        if change.undo:
            last = find_last(standing)
            standing = [other for other in standing if other is not last]
        else:
            standing.append(change)
    return standing


def find_last(standing: list[Change]) -> Change | None:
    """Return the change that an undo takes back: the last that is not of the length; or None."""
    numbers = [change for change in standing if change.name != STEPS]
    return numbers[-1] if numbers else None


def apply_change(config: TrainConfig, change: Change) -> TrainConfig:
    """Return `config` after a change; `UserError` for a value that the setting cannot have."""
    if change.name == STEPS:
        return change_settings(config, {STEPS: max(config.steps, change.new)})
    if change.adds_term:
        term = from_dict(Reward, change.new, Path(), change.name)  # one of the package
        return change_settings(config, {change.name: term})
    return change_number(config, change.name, change.new)


def change_number(config: TrainConfig, name: str, value: Any) -> TrainConfig:
    """Return `config` with another value for a number that `quadwalk.env.numbers` names."""
    setting, _, end = name.rpartition(".")
    if end not in ("0", "1"):
        return change_settings(config, {name: value})
    ends = [get_numbers(config.env, [f"{setting}.{place}"]).popitem()[1] for place in "01"]
    ends[int(end)] = value
    return change_settings(config, {setting: tuple(ends)})


def describe_changes(start: TrainConfig, present: TrainConfig) -> dict[str, Any]:
    """Return each setting that the desk has changed, with its value at the start and now.

    {"env.reward.energy": {"start": -0.02, "now": -0.2}}; a term that was added has None as start.
    """
    before, now = flatten(start.env), flatten(present.env)
    return {
        f"env.{name}": {"start": before.get(name), "now": value}
        for name, value in now.items()
        if before.get(name) != value
    }
