"""Settings to search, each with the values that it may have."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from quadwalk.cli.shell import import_extra
from quadwalk.errors import UsageError, suggest
from quadwalk.settings.serialize import flatten, with_settings
from quadwalk.settings.training import TrainConfig

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

_FORMS = "NAME=LOW:HIGH, NAME=LOW:HIGH:log or NAME=VALUE,VALUE,..."
_DIGITS = 4  # of a value that is searched: so many a flag repeats exactly


def read_space(texts: Sequence[str], config: TrainConfig) -> dict[str, "BaseDistribution"]:
    """Return the distribution of each setting that `--over` names, by its name as in flags.

    Raises a `UsageError` for a name that `config` lacks, a value that it cannot have, and a name
    that comes twice.
    """
    settings = flatten(config)
    space: dict[str, BaseDistribution] = {}
    for text in texts:
        name, _, values = text.partition("=")
        name = name.strip().removeprefix("--").replace("-", "_")
        if name not in settings:
            name = name.removesuffix(".scale")  # a reward is its scale
        if name not in settings:
            raise UsageError(
                f"--over {text}: there is no setting {name!r}{suggest(name, settings)}"
            )
        if name in space:
            raise UsageError(f"--over names {name} twice; expected each setting once")
        space[name], ends = _read_values(text, values, settings[name])
        for value in ends:
            with_settings(config, {name: value})
    return space


def _read_values(text: str, values: str, now: Any) -> tuple["BaseDistribution", list[Any]]:
    """Return a distribution of `values`, and those of them that the text names."""
    distributions = import_extra("optuna", "tune", "tune").distributions
    if "," in values:
        choices = [_to_number(value) for value in values.split(",")]
        return distributions.CategoricalDistribution(choices), choices
    parts = values.split(":")
    log = parts[2:] == ["log"]
    try:
        low, high = map(float, parts[: -1 if log else None])
    except ValueError:
        raise UsageError(f"--over {text}; expected {_FORMS}") from None
    if not low < high or (log and low <= 0.0):
        raise UsageError(f"--over {text}; expected LOW below HIGH, and above 0 with log")
    if isinstance(now, int) and low.is_integer() and high.is_integer():
        ends = [int(low), int(high)]
        return distributions.IntDistribution(*ends, log=log), ends
    return distributions.FloatDistribution(low, high, log=log), [low, high]


def _to_number(text: str) -> Any:
    """Return a choice as a number if it is one."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def round_values(params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a trial to as many digits as its flags show."""
    return {
        name: float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
        for name, value in params.items()
    }


def to_flags(params: Mapping[str, Any]) -> list[str]:
    """Return the values of a trial as flags of `quadwalk train`."""
    values = round_values(params)
    return [f"--{name.replace('_', '-')}={value}" for name, value in values.items()]
