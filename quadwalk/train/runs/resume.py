"""Going on with a run: its configuration, what may change in it, and its saved state."""

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING

from quadwalk.errors import UsageError, UserError
from quadwalk.files import os_reason
from quadwalk.train.metrics import TrainingMetrics
from quadwalk.train.runs import checkpoint
from quadwalk.train.runs.directory import Run, find_run
from quadwalk.train.settings import DistributedConfig, TrainConfig, flatten, from_dict

if TYPE_CHECKING:
    from quadwalk.train.ppo import TrainState

# The saved state has the shape of these, or was drawn from them once and for all.
_FIXED = ("seed", "envs", "ppo.eval_envs", "ppo.hidden", "ppo.activation")
# How a run is driven, not what it computes.
_FREE = (
    *("name", "runs", "resume", "minutes", "checkpoint_steps", "quiet"),
    *("distributed.coordinator", "distributed.processes", "distributed.process"),
)


def read_config(run: Run) -> TrainConfig:
    """The configuration in a run's config.json."""
    try:
        data = json.loads(run.config.read_text())["config"]
    except OSError as error:
        raise UserError(f"cannot read {run.config}: {os_reason(error)}") from None
    except (ValueError, KeyError, TypeError):
        raise UserError(f"{run.config} is damaged: expected JSON with a 'config'") from None
    return from_dict(TrainConfig, data, where=f"{run.config}: config")


def resumed_config(runs: Path | str, which: str) -> TrainConfig:
    """The configuration to go on with run `which` of folder `runs`, before further flags."""
    run = find_run(runs, which)
    config = read_config(run)
    return dataclasses.replace(
        config,
        # By its name, lest another run has become the latest when it is looked up again.
        resume=run.name if which == "latest" else which,
        name=None,
        runs=Path(runs),
        minutes=None,
        quiet=False,
        distributed=DistributedConfig(),
    )


def changed_settings(before: TrainConfig, now: TrainConfig) -> list[str]:
    """What differs, as "name: old -> new"; `UsageError` for what cannot change in a run."""
    old, new = flatten(before), flatten(now)
    names = [name for name in old if old[name] != new[name] and name not in _FREE]
    for name in names:
        if name in _FIXED:
            flag = name.replace("_", "-")
            raise UsageError(f"--{flag} cannot change in a run that goes on: it is {old[name]}")
    return [f"{name}: {old[name]} -> {new[name]}" for name in names]


def restore(
    path: Path, state: "TrainState", metrics: TrainingMetrics
) -> tuple["TrainState", int, float]:
    """The state in checkpoint `path`, placed as `state` is; its control steps and seconds.

    `metrics` go on counting from there. On another number of devices than before, each draws from
    a random key of its own anew; all else goes on as it was. Raises `UserError` in one line.
    """
    import jax

    from quadwalk.train.ppo import placed_like

    leaves, metadata = checkpoint.load(path, "checkpoint")
    keys, devices = leaves.get("workers/key"), len(state.workers.key)
    like = state
    if keys is not None and keys.ndim == 2 and len(keys) != devices:
        like = state._replace(workers=state.workers._replace(key=keys))
    saved, _ = checkpoint.load(path, "checkpoint", like=like)
    if like is not state:
        split = jax.device_get(jax.random.split(saved.workers.key[0], devices))
        saved = saved._replace(workers=saved.workers._replace(key=split))
    try:
        metrics.restore(metadata["metrics"])
        steps, seconds = int(metadata["steps"]), float(metadata["seconds"])
    except (KeyError, TypeError, ValueError):
        raise UserError(f"{path} does not say where its training was: expected another") from None
    return placed_like(saved, state), steps, seconds
