"""Settings as JSON data, as a flat list of names, and with some of them changed."""

import dataclasses
import difflib
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from quadwalk.errors import UsageError, UserError
from quadwalk.task.terms import Reward, Term
from quadwalk.task_files import own_file, reference, resolve

T = TypeVar("T")


def to_dict(config: Any) -> Any:
    """A configuration as JSON data; a term's function by its reference."""
    if dataclasses.is_dataclass(config):
        return {f.name: to_dict(getattr(config, f.name)) for f in dataclasses.fields(config)}
    if isinstance(config, dict):
        return {key: to_dict(item) for key, item in config.items()}
    if isinstance(config, tuple):
        return [to_dict(item) for item in config]
    if callable(config):
        return reference(config)
    return str(config) if isinstance(config, Path) else config


def from_dict(cls: type[T], data: Any, folder: Path, where: str = "config") -> T:
    """The configuration that `to_dict` wrote, of the run in `folder`.

    `UserError` names what does not fit.
    """
    if not isinstance(data, dict):
        raise UserError(f"{where} is {data!r}; expected a group of settings")
    hints = typing.get_type_hints(cls)
    for key in data:
        if key not in hints:
            raise UserError(f"{where}.{key} is not a setting of this version")
    values = {
        key: _restore(hints[key], value, folder, f"{where}.{key}") for key, value in data.items()
    }
    try:
        return cls(**values)
    except TypeError as error:  # settings that are missing
        raise UserError(f"{where}: {str(error).partition('() ')[2]}") from None


def _restore(hint: Any, value: Any, folder: Path, where: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return from_dict(hint, value, folder, where)  # type: ignore[arg-type]
    if hint is Any:  # parameters of a term
        return value
    if isinstance(hint, types.UnionType):
        if value is None and type(None) in hint.__args__:
            return None
        hint = next(option for option in hint.__args__ if option is not type(None))
    origin = typing.get_origin(hint) or hint
    if origin is typing.Literal:  # of strings: the class itself checks which
        origin = hint = str
    if origin is Callable and isinstance(value, str):
        return resolve(value, folder)
    if origin is dict and isinstance(value, dict):
        item = hint.__args__[1]
        return {k: _restore(item, v, folder, f"{where}.{k}") for k, v in value.items()}
    if origin is tuple and isinstance(value, list | tuple):
        return tuple(_restore(hint.__args__[0], item, folder, where) for item in value)
    if origin is Path and isinstance(value, str):
        return Path(value)
    if origin is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, origin) or (isinstance(value, bool) and origin is not bool):
        raise UserError(f"{where} is {value!r}; expected {getattr(hint, '__name__', hint)}")
    return value


def flatten(config: Any, prefix: str = "") -> dict[str, Any]:
    """Every setting by its name with dots, as a flag would name it: "env.reward.energy".

    A term's function is named by its reference, as "env.reward.energy.function".
    """
    if isinstance(config, dict) or dataclasses.is_dataclass(config):
        flat: dict[str, Any] = {}
        for name, value in _parts(config).items():
            flat |= flatten(value, f"{prefix}.{name}".strip("."))
        return flat
    return {prefix.removesuffix("."): reference(config) if callable(config) else config}


def _parts(config: Any) -> dict[str, Any]:
    """What a group of settings is made of, by the names that flags give it."""
    if isinstance(config, dict):
        return config
    parts = {f.name: getattr(config, f.name) for f in dataclasses.fields(config)}
    if isinstance(config, Term):
        parts |= parts.pop("params") or {}
        if isinstance(config, Reward):
            parts[""] = parts.pop("scale")
    return parts


def with_settings(config: T, changes: Mapping[str, Any]) -> T:
    """`config` with settings changed by their names: {"env.reward.energy": -0.5}.

    A term as a value is put in the place of one, or added. `UsageError` for a name or value that
    cannot be.
    """
    for name, value in changes.items():
        config = _changed(config, name, name.split("."), value)
    return config


def _changed(config: Any, name: str, path: list[str], value: Any) -> Any:
    head, *rest = path
    if isinstance(config, dict):
        if not rest and isinstance(value, Term):
            return {**config, head: value}
        _check_name(head, config, name)
        return {**config, head: _changed_item(config[head], name, rest, value)}
    fields = {f.name for f in dataclasses.fields(config)}
    if isinstance(config, Term) and head in (config.params or {}):
        params = {**config.params, head: _restore(float, value, Path(), name)}
        return dataclasses.replace(config, params=params)
    _check_name(head, fields, name)
    if rest or isinstance(getattr(config, head), Term):
        new = _changed_item(getattr(config, head), name, rest, value)
    else:
        hint = typing.get_type_hints(type(config))[head]
        try:
            new = value if _is(value, hint) else _restore(hint, value, Path(), name)
        except UserError as error:
            raise UsageError(str(error)) from None
    return dataclasses.replace(config, **{head: new})


def _changed_item(item: Any, name: str, rest: list[str], value: Any) -> Any:
    if rest:
        if not (isinstance(item, dict) or dataclasses.is_dataclass(item)):
            raise UsageError(f"no setting {name!r}: {rest[0]!r} is not part of a number")
        return _changed(item, name, rest, value)
    if isinstance(item, Reward) and not isinstance(value, Term):
        return dataclasses.replace(item, scale=_restore(float, value, Path(), name))
    return value


def _is(value: Any, hint: Any) -> bool:
    return dataclasses.is_dataclass(hint) and isinstance(value, hint)  # type: ignore[arg-type]


def _check_name(part: str, known: Any, name: str) -> None:
    if part not in known:
        close = difflib.get_close_matches(part, list(known), 1)
        hint = f"; did you mean {close[0]!r}?" if close else f"; expected one of {sorted(known)}"
        raise UsageError(f"no setting {name!r}: there is no {part!r}{hint}")


def task_source(config: Any) -> bytes | None:
    """The file of the task's own functions, to be kept with a run; None if it has none."""

    def functions(part: Any) -> list[Callable[..., Any]]:
        if isinstance(part, Term):
            return [part.function]
        if isinstance(part, dict) or dataclasses.is_dataclass(part):
            return [f for item in _parts(part).values() for f in functions(item)]
        return []

    return own_file(functions(config))
