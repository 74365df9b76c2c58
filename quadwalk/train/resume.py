"""Going on with a run: its configuration, and what may change in it."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from quadwalk.errors import UsageError, UserError
from quadwalk.files import why
from quadwalk.train.config import TrainConfig, from_dict
from quadwalk.train.run import Run, find_run

# The saved state has the shape of these, or was drawn from them once and for all.
_FIXED = ("seed", "envs", "ppo.judges", "ppo.hidden", "ppo.activation")
# How a run is driven, not what it computes.
_FREE = ("name", "runs", "resume", "minutes", "checkpoint_steps", "devices", "quiet")


def read_config(run: Run) -> TrainConfig:
    """The configuration in a run's config.json."""
    try:
        data = json.loads(run.config.read_text())["config"]
    except OSError as error:
        raise UserError(f"cannot read {run.config}: {why(error)}") from None
    except (ValueError, KeyError, TypeError):
        raise UserError(f"{run.config} is damaged: expected JSON with a 'config'") from None
    return from_dict(TrainConfig, data, where=f"{run.config}: config")


def resumed_config(runs: Path | str, which: str) -> TrainConfig:
    """The configuration to go on with run `which` of folder `runs`, before further flags."""
    run = find_run(runs, which)
    config = read_config(run)
    return dataclasses.replace(
        config,
        resume=which,
        name=None,
        runs=Path(runs),
        minutes=None,
        quiet=False,
    )


def changed_settings(before: TrainConfig, now: TrainConfig) -> list[str]:
    """What differs, as "name: old -> new"; `UsageError` for what cannot change in a run."""
    old, new = _flatten(before), _flatten(now)
    names = [name for name in old if old[name] != new[name] and name not in _FREE]
    for name in names:
        if name in _FIXED:
            flag = name.replace("_", "-")
            raise UsageError(f"--{flag} cannot change in a run that goes on: it is {old[name]}")
    return [f"{name}: {old[name]} -> {new[name]}" for name in names]


def _flatten(config: Any, prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            flat |= _flatten(value, f"{prefix}{field.name}.")
        else:
            flat[prefix + field.name] = value
    return flat
