"""What a training tells the page of its desk, as dicts of JSON."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from quadwalk.env.numbers import Number, get_numbers, get_summary, list_numbers
from quadwalk.learn.recipe import list_available_terms
from quadwalk.runs.changes import Change, apply_change
from quadwalk.settings.training import TrainConfig

_TERM = "train/reward/"  # before a term's name in a row of metrics


def make_iteration_message(
    iteration: int, steps: int, seconds: float, row: Mapping[str, float]
) -> dict[str, Any]:
    """Return what an iteration came to: its `row` of metrics, and each term's share of the reward.

    `iteration` and `steps` count those done, `seconds` is the time of training.
    """
    numbers = {name: _to_json(value) for name, value in row.items()}
    shares = {
        name.removeprefix(_TERM): value for name, value in numbers.items() if name.startswith(_TERM)
    }
    return {
        "type": "iteration",
        "iteration": iteration,
        "steps": steps,
        "seconds": seconds,
        "shares": shares,
        "row": numbers,
    }


def make_state_message(
    start: TrainConfig, present: TrainConfig, program: TrainConfig, changes: Iterable[Change]
) -> dict[str, Any]:
    """Return the numbers of a desk, the terms that can be added, and the `changes` that hold.

    `program` says which numbers there are. A term that was added started as it was added.
    """
    changes = list(changes)
    for change in changes:
        start = apply_change(start, change) if change.adds_term else start
    numbers = list_numbers(program.env)
    names = [number.name for number in numbers]
    now, before = get_numbers(present.env, names), get_numbers(start.env, names)
    return {
        "type": "desk",
        "total": present.steps,
        "numbers": [
            describe_number(number, now[number.name], before[number.name]) for number in numbers
        ],
        "available": [
            {"term": name, "help": get_summary(term.function)}
            for name, term in list_available_terms(present).items()
        ],
        "changes": [describe_change(change) for change in changes],
    }


def describe_number(number: Number, value: float, start: float) -> dict[str, Any]:
    """Return a number as the page gets it."""
    low, high = number.bounds.ends
    return {
        "name": number.name,
        "term": number.term,
        "group": number.group,
        "label": number.label,
        "value": value,
        "start": start,
        "low": low,
        "high": high,
        "unit": number.unit,
        "help": number.help,
    }


def describe_change(change: Change) -> dict[str, Any]:
    """Return a change as the page gets it; a term that was added is there by its scale."""
    return {
        "iteration": change.iteration,
        "steps": change.steps,
        "name": change.name,
        "old": change.old,
        "new": change.new["scale"] if change.adds_term else change.new,
    }


def _to_json(value: float) -> float | None:
    """Return a number as JSON has it, which knows neither NaN nor infinity."""
    return float(value) if math.isfinite(value) else None
