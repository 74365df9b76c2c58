"""Settings as JSON data, as a flat list of names, and with some of them changed."""

import dataclasses
import reprlib
import sys
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from quadwalk.errors import UsageError, UserError, suggest
from quadwalk.settings.registry import find_term, get_task_source, get_term_name, to_current_name
from quadwalk.settings.terms import Reward, Term

T = TypeVar("T")

# The names of settings in files of earlier versions, and those of today.
OLD_NAMES = {
    "EnvConfig": {"randomisation": "randomization"},
    "RandomizationConfig": {"trunk_centre": "trunk_center"},
    "PPOConfig": {
        "clip": "clip_epsilon",
        "noise": "init_std",
        "value": "value_coef",
        "settle": "anneal_share",
    },
}
# Likewise of parts of observations, by their functions.
OLD_PARTS = {
    ("position", "observation:joint_pos"): "joint_pos",
    ("position", "observation:joint_angles"): "joint_pos",
    ("speed", "observation:joint_vel"): "joint_vel",
}


def to_dict(config: Any) -> Any:
    """Convert a configuration to JSON data; terms' functions become their registered names."""
    if dataclasses.is_dataclass(config):
        return {f.name: to_dict(getattr(config, f.name)) for f in dataclasses.fields(config)}
    if isinstance(config, dict):
        return {key: to_dict(item) for key, item in config.items()}
    if isinstance(config, tuple):
        return [to_dict(item) for item in config]
    if callable(config):
        return get_term_name(config)
    return str(config) if isinstance(config, Path) else config


def from_dict(cls: type[T], data: Any, folder: Path, where: str = "config") -> T:
    """Restore a configuration from the data of `to_dict`; `folder` is the run's, for its task.py.

    Raises a `UserError` that names the setting that does not fit.
    """
    if not isinstance(data, dict):
        raise UserError(f"{where} is {reprlib.repr(data)}; expected a group of settings")
    hints = typing.get_type_hints(cls)
    renamed = OLD_NAMES.get(cls.__name__, {})
    data = {renamed.get(key, key): value for key, value in data.items()}
    for key in data:
        if key not in hints:
            raise UserError(f"{where}.{key} is not a setting of this version")
    fields: Any = dataclasses.fields(cls)  # type: ignore[arg-type]
    for field in fields:
        if field.name not in data and field.default is field.default_factory:  # MISSING, both
            raise UserError(f"{where}.{field.name} is missing")
    values = {
        key: _restore(hints[key], value, folder, f"{where}.{key}") for key, value in data.items()
    }
    try:
        return cls(**values)
    except UsageError as error:
        raise UserError(f"{where}: {error}") from None


def _restore(hint: Any, value: Any, folder: Path, where: str) -> Any:
    """Return the value of the setting `where`, of type `hint`, from its JSON data."""
    if dataclasses.is_dataclass(hint):
        if isinstance(value, hint):  # type: ignore[arg-type]
            return value
        return from_dict(hint, value, folder, where)  # type: ignore[arg-type]
    if hint is Any:  # parameters of a term
        return value
    options = typing.get_args(hint)
    if type(None) in options:
        if value is None:
            return None
        hint = next(option for option in options if option is not type(None))
    origin = typing.get_origin(hint) or hint
    if origin is typing.Literal:  # of strings: the class itself checks which
        origin = hint = str
    if origin is Callable and isinstance(value, str):
        try:
            return find_term(value, folder)
        except UserError as error:
            raise UserError(f"{where}: {error}") from None
    if origin is dict and isinstance(value, dict):
        item = hint.__args__[1]
        return {
            _to_current_part(k, v): _restore(item, v, folder, f"{where}.{k}")
            for k, v in value.items()
        }
    if origin is tuple and isinstance(value, list | tuple):
        return tuple(_restore(hint.__args__[0], item, folder, where) for item in value)
    if origin is Path and isinstance(value, str) and "\0" not in value:
        return Path(value)
    if origin is float and type(value) is int and abs(value) < sys.float_info.max:
        return float(value)
    if not isinstance(value, origin) or (isinstance(value, bool) and origin is not bool):
        expected = getattr(hint, "__name__", hint)
        raise UserError(f"{where} is {reprlib.repr(value)}; expected {expected}")
    return value


def _to_current_part(name: str, value: Any) -> str:
    """Return the name that the observation `name` has in this version; `value` is its data."""
    function = value.get("function") if isinstance(value, dict) else None
    return OLD_PARTS.get((name, to_current_name(str(function))), name)


def flatten(config: Any, prefix: str = "") -> dict[str, Any]:
    """Return all settings by the names of their flags, such as "env.reward.energy".

    The function of a term has its registered name as value, at "env.reward.energy.function".
    """
    if isinstance(config, dict) or dataclasses.is_dataclass(config):
        flat: dict[str, Any] = {}
        for name, value in _get_parts(config).items():
            flat |= flatten(value, f"{prefix}.{name}".strip("."))
        return flat
    return {prefix.removesuffix("."): get_term_name(config) if callable(config) else config}


def _get_parts(config: Any) -> dict[str, Any]:
    """Return the settings of a group by the names that flags give them."""
    if isinstance(config, dict):
        return config
    parts = {f.name: getattr(config, f.name) for f in dataclasses.fields(config)}
    if isinstance(config, Term):
        parts |= parts.pop("params") or {}
        if isinstance(config, Reward):
            parts[""] = parts.pop("scale")
    return parts


def change_settings(config: T, changes: Mapping[str, Any]) -> T:
    """Return `config` with settings changed by their names, as {"env.reward.energy": -0.5}.

    A value that is a term replaces the term of that name, or is added. Raises `UsageError` for a
    wrong name or value.
    """
    paths = [(name, name.split("."), value) for name, value in changes.items()]
    try:
        return _change(config, type(config), paths)
    except UserError as error:
        raise UsageError(str(error)) from None


def _change(item: Any, hint: Any, changes: list[tuple[str, list[str], Any]]) -> Any:
    """Return `item`, of type `hint`, with all `changes` made at once: one may not fit alone.

    A change is the full name of a setting, the rest of its path below `item`, and its new value.
    """
    inner: dict[str, list[tuple[str, list[str], Any]]] = {}
    for name, path, value in changes:
        if path:
            inner.setdefault(path[0], []).append((name, path[1:], value))
        elif isinstance(item, Reward) and not isinstance(value, Term):
            item = dataclasses.replace(item, scale=_restore(float, value, Path(), name))
        else:
            item = _restore(hint, value, Path(), name)
    params = (item.params or {}) if isinstance(item, Term) else {}
    if not inner:
        return item
    if isinstance(item, dict):
        parts, hints = item, dict.fromkeys(inner, typing.get_args(hint)[1])
    elif dataclasses.is_dataclass(item):
        parts = {**vars(item), **params}
        hints = typing.get_type_hints(type(item)) | dict.fromkeys(params, float)
    else:
        part, ((name, *_), *_) = inner.popitem()
        raise UsageError(f"no setting {name!r}: {part!r} is not part of a number")
    new = {}
    for head, group in inner.items():
        name, path, value = group[0]
        if path or not (isinstance(item, dict) and isinstance(value, Term)):  # one can be added
            _check_name(head, parts, name)
        new[head] = _change(parts.get(head), hints[head], group)
    if isinstance(item, dict):
        return {**item, **new}
    if params:
        new["params"] = {key: new.pop(key, old) for key, old in params.items()}
    return dataclasses.replace(item, **new)


def _check_name(part: str, parts: Any, name: str) -> None:
    """Raise `UsageError` for the setting `name` unless its `part` is one of `parts`."""
    if part not in parts:
        hint = suggest(part, parts) or f"; expected one of {sorted(parts)}"
        raise UsageError(f"no setting {name!r}: there is no {part!r}{hint}")


def find_task_source(config: Any) -> bytes | None:
    """Return the user's task file that defines functions of `config`, to copy it into the run.

    None if all functions are of the package.
    """
    return get_task_source(_list_functions(config))


def _list_functions(part: Any) -> list[Callable[..., Any]]:
    """Return the functions of all terms in a configuration."""
    if isinstance(part, Term):
        return [part.function]
    if isinstance(part, dict) or dataclasses.is_dataclass(part):
        return [f for item in _get_parts(part).values() for f in _list_functions(item)]
    return []
