"""The numbers of a task that may change while its programs run, by the names of their flags.

A number is named by its way through `EnvConfig`: "env.reward.track.width" is a parameter,
"env.reward.track.scale" its term's scale, "env.command.forward.1" the upper end of a range. What
decides the shape of a program is not among them: times, delays, observations, physics.
"""

import copy
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from quadwalk.bounds import Bounds, find_bounds
from quadwalk.settings.environment import CommandConfig, EnvConfig, RandomizationConfig
from quadwalk.settings.terms import Reward, Term

_PREFIX = "env."
_ENDS = ("low", "high")  # of a range
_COMMAND_UNITS = {
    "forward": "m/s",
    "lateral": "m/s",
    "yaw_rate": "rad/s",
    "lateral_until": "m/s",
    "turning": "m/s^2",
    "acceleration": "m/s^2",
    "still": "m/s",
}
_COMMAND_SHARES = ("standing", "straight", "spot", "slow")
# The longest delays say how many targets and readings a state keeps.
_DELAYS = ("latency", "sensor_latency")


@dataclass(frozen=True)
class Number:
    """One number of a task, as a page shows it."""

    name: str  # env.reward.track.width
    group: str  # reward, termination, command or randomization
    term: str  # what it belongs to in the group: track
    label: str  # which number of that it is: width
    bounds: Bounds
    unit: str
    help: str  # one line on the term


def list_numbers(config: EnvConfig) -> list[Number]:
    """Return the numbers of a task that may change, in the task's order."""
    numbers = [
        *_list_term_numbers("reward", config.reward),
        *_list_term_numbers("termination", config.termination),
    ]
    if config.command.active:
        numbers += _list_command_numbers(config.command)
    if config.randomization.enabled:
        numbers += _list_randomization_numbers(config.randomization)
    return numbers


def _list_term_numbers(group: str, terms: Mapping[str, Term]) -> Iterator[Number]:
    for name, term in terms.items():
        line = get_summary(term.function)
        labels = [*(["scale"] if isinstance(term, Reward) else []), *(term.params or {})]
        for label in labels:
            full_name = f"{_PREFIX}{group}.{name}.{label}"
            yield Number(full_name, group, name, label, Bounds(), "", line)


def _list_command_numbers(command: CommandConfig) -> Iterator[Number]:
    for field in (*_COMMAND_UNITS, *_COMMAND_SHARES):
        value = getattr(command, field)
        # Programs leave these out where they are 0.
        if value is None or (field in ("spot", "slow", "still") and not value):
            continue
        yield from _list_field_numbers("command", command, field, _COMMAND_UNITS.get(field, ""))


def _list_randomization_numbers(ranges: RandomizationConfig) -> Iterator[Number]:
    for field, value in vars(ranges).items():
        if isinstance(value, tuple) and field not in _DELAYS:
            yield from _list_field_numbers("randomization", ranges, field, "")


def _list_field_numbers(group: str, settings: Any, field: str, unit: str) -> Iterator[Number]:
    """Yield both ends of a range, or the one number of another field."""
    bounds = find_bounds(typing.get_type_hints(type(settings), include_extras=True)[field])
    line = get_summary(type(settings))
    name = f"{_PREFIX}{group}.{field}"
    if isinstance(getattr(settings, field), tuple):
        for end, label in enumerate(_ENDS):
            yield Number(f"{name}.{end}", group, field, label, bounds, unit, line)
    else:
        yield Number(name, group, field, "value", bounds, unit, line)


def get_summary(described: Any) -> str:
    """Return the first line of a docstring, "" without one."""
    return (described.__doc__ or "").strip().partition("\n")[0]


def get_numbers(config: EnvConfig, names: Iterable[str]) -> dict[str, Any]:
    """Return the values that a task has for these names."""
    values = {}
    for name in names:
        value: Any = config
        for key in _split(name):
            value = _get_part(value, key)
        values[name] = value
    return values


def replace_numbers(config: EnvConfig, values: Mapping[str, Any]) -> EnvConfig:
    """Return a task with other values for these names.

    Nothing checks them: they may be arguments of a program that is traced.
    """
    for name, value in values.items():
        config = _replace_part(config, _split(name), value)
    return config


def _split(name: str) -> list[str]:
    return name.removeprefix(_PREFIX).split(".")


def _get_part(item: Any, key: str) -> Any:
    if isinstance(item, dict):
        return item[key]
    if isinstance(item, tuple):
        return item[int(key)]
    if isinstance(item, Term) and key in (item.params or {}):
        return item.params[key]
    return getattr(item, key)


def _replace_part(item: Any, keys: list[str], value: Any) -> Any:
    """Return `item` with the part replaced that `keys` lead to."""
    if not keys:
        return value
    key, *rest = keys
    part = _replace_part(_get_part(item, key), rest, value)
    if isinstance(item, dict):
        return {**item, key: part}
    if isinstance(item, tuple):
        index = int(key)
        return (*item[:index], part, *item[index + 1 :])
    if isinstance(item, Term) and key in (item.params or {}):
        key, part = "params", {**item.params, key: part}
    changed = copy.copy(item)
    object.__setattr__(changed, key, part)  # frozen, and its checks are for plain numbers
    return changed
