"""Settings to search, each with the values that it may have."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from quadwalk.command.shell import extra
from quadwalk.errors import UsageError, meant
from quadwalk.settings.serialize import flatten, with_settings
from quadwalk.settings.training import TrainConfig

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

_FORMS = "NAME=LOW:HIGH, NAME=LOW:HIGH:log or NAME=VALUE,VALUE,..."
_DIGITS = 4  # of a value that is searched: so many a flag repeats exactly


@dataclass(frozen=True)
class Dimension:
    """One setting, by its name as in flags, and its range or its choices."""

    name: str
    ends: tuple[float, float] = (0.0, 0.0)
    choices: tuple[Any, ...] = ()
    log: bool = False
    whole: bool = False

    def distribution(self) -> "BaseDistribution":
        distributions = extra("optuna", "tune", "tune").distributions
        if self.choices:
            return distributions.CategoricalDistribution(self.choices)
        if self.whole:
            low, high = map(int, self.ends)
            return distributions.IntDistribution(low, high, log=self.log)
        return distributions.FloatDistribution(*self.ends, log=self.log)


def dimension(text: str, config: TrainConfig) -> Dimension:
    """What a value of --over says; `UsageError` unless it is of `config` and all values may be."""
    name, equals, values = text.partition("=")
    name = name.strip().removeprefix("--").replace("-", "_")
    known = flatten(config)
    # A reward is its scale.
    name = name.removesuffix(".scale") if name not in known else name
    if name not in known:
        raise UsageError(f"--over {text}: there is no setting {name!r}{meant(name, known)}")
    if not equals or not values:
        raise UsageError(f"--over {text}; expected {_FORMS}")
    if "," in values:
        found = Dimension(name, choices=tuple(map(_value, values.split(","))))
    else:
        found = _range(text, name, values, known[name])
    for value in found.choices or found.ends:
        with_settings(config, {name: int(value) if found.whole else value})
    return found


def _range(text: str, name: str, values: str, now: Any) -> Dimension:
    parts = values.split(":")
    log = parts[2:] == ["log"]
    try:
        low, high = map(float, parts[: -1 if log else None])
    except ValueError:
        raise UsageError(f"--over {text}; expected {_FORMS}") from None
    if not low < high or (log and low <= 0.0):
        raise UsageError(f"--over {text}; expected LOW below HIGH, and above 0 with log")
    whole = isinstance(now, int) and low.is_integer() and high.is_integer()
    return Dimension(name, (low, high), log=log, whole=whole)


def _value(text: str) -> Any:
    """A choice: a number if it is one."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def rounded(params: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a trial, to as many digits as its flags show."""
    return {
        name: float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
        for name, value in params.items()
    }


def as_flags(params: Mapping[str, Any]) -> list[str]:
    """A trial's values as flags of `quadwalk train`."""
    return [f"--{name.replace('_', '-')}={value}" for name, value in rounded(params).items()]


def dimensions(texts: Sequence[str], config: TrainConfig) -> list[Dimension]:
    """All that is searched; `UsageError` for a setting that is named twice."""
    found = [dimension(text, config) for text in texts]
    names = [each.name for each in found]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"--over names {name} twice; expected each setting once")
    return found
