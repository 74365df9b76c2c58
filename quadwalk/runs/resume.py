"""Resuming a run: its configuration, and what may change in it."""

import dataclasses
import json
from typing import Any

from quadwalk.errors import UsageError, UserError
from quadwalk.files import DAMAGE, read_bytes
from quadwalk.runs.directory import Run
from quadwalk.settings.serialize import flatten, from_dict
from quadwalk.settings.training import DistributedConfig, TrainConfig, with_files

# The saved state has the shape of these, or was drawn from them once and for all.
_FIXED = ("seed", "envs", "ppo.eval_envs", "ppo.hidden", "ppo.activation", "ppo.symmetric")
# How a run is driven, not what it computes.
_FREE = (
    *("task", "name", "runs", "init", "minutes", "checkpoint_steps", "quiet"),
    *("log", "watch"),
    *("distributed.coordinator", "distributed.processes", "distributed.process"),
)


def read_config(run: Run) -> TrainConfig:
    """The configuration in a run's config.json."""
    try:
        content = json.loads(read_bytes(run.config))
        data, version = content["config"], content["versions"]["quadwalk"]
    except DAMAGE:
        raise UserError(f"{run.config} is damaged: expected JSON with a 'config'") from None
    return config_of(data, run, f"{run.config}: config", version)


def config_of(data: Any, run: Run, where: str, version: str) -> TrainConfig:
    """The configuration in `data`, of `run`, which quadwalk `version` wrote in the file `where`.

    It names the run's own copies of the robot and the ground; meshes are where they were.
    """
    if isinstance(data, dict) and "task" not in data:
        raise UserError(
            f"{where} is of quadwalk {version} or before, which this version cannot read; expected "
            "a newer run: train it again, or evaluate it with that version"
        )
    config = from_dict(TrainConfig, data, run.path, where)
    robot, ground = config.robot, config.env.ground.file
    folders = tuple(dict.fromkeys((robot.urdf.parent, *robot.mesh_dirs)))
    if ground is not None and run.ground(ground).exists():  # older runs have no copy
        ground = run.ground(ground)
    return with_files(config, run.urdf, folders, ground)


def resumed_config(run: Run) -> TrainConfig:
    """The configuration to resume a run, before any changes."""
    return dataclasses.replace(
        read_config(run),
        name=None,
        runs=run.path.parent,
        minutes=None,
        quiet=False,
        watch=False,
        distributed=DistributedConfig(),
    )


def changed_settings(before: TrainConfig, now: TrainConfig) -> list[str]:
    """What differs, as "name: old -> new"; `UsageError` for what cannot change in a run."""
    old, new = flatten(before), flatten(now)
    names = [n for n in {**old, **new} if old.get(n) != new.get(n) and n not in _FREE]
    for name in names:
        if name in _FIXED:
            flag = name.replace("_", "-")
            raise UsageError(f"--{flag} cannot change when a run is resumed: it is {old[name]}")
    return [f"{name}: {old.get(name)} -> {new.get(name)}" for name in names]
