"""The settings of a run: written to its folder, read, compared, and made ready to resume it."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from quadwalk.errors import UsageError, UserError
from quadwalk.files import (
    DAMAGE,
    format_json,
    hash_file,
    open_atomic,
    read_bytes,
    resolve_path,
    write_json,
)
from quadwalk.robot.load import hash_robot
from quadwalk.robot.mjcf import write_xml
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs.directory import Run, create_run, delete_partial_files, get_versions
from quadwalk.settings.environment import EnvConfig
from quadwalk.settings.serialize import find_task_source, flatten, from_dict, to_dict
from quadwalk.settings.training import DistributedConfig, Suite, TrainConfig, set_files
from quadwalk.task_files import TASK_FILE

ROBOT_HASH = "robot_sha256"  # in a run's config.json

# The saved state has the shape of these, or was drawn from them once and for all.
_FIXED = ("seed", "envs", "ppo.eval_envs", "ppo.hidden", "ppo.activation", "ppo.symmetric")
# How a run is driven, not what it computes.
_FREE = (
    *("task", "suite", "name", "runs", "init", "minutes", "checkpoint_steps", "quiet"),
    *("log", "watch", "desk", "replay"),
    *("distributed.coordinator", "distributed.processes", "distributed.process"),
)


def make_run(config: TrainConfig, quadruped: Quadruped, changes: bytes | None = None) -> Run:
    """Make the folder of a new run, with copies of all files that its training begins with.

    `changes` is the content of its desk.jsonl, None without a desk.
    """
    files = {
        "robot.urdf": quadruped.urdf.encode(),
        "config.json": format_json(_collect_settings(config, quadruped)),
    }
    if changes is not None:
        files[Run(Path()).desk.name] = changes
    source, heights = find_task_source(config), config.env.ground.file
    if source is not None:
        files[TASK_FILE] = source
    if heights is not None:
        files[Run(Path()).locate_heights(heights).name] = read_bytes(heights)
    return create_run(config.runs, config.name, label=config.task, files=files)


def update_run(run: Run, config: TrainConfig, quadruped: Quadruped) -> list[str]:
    """Write to `run` the settings with which it is resumed; return a line for each change."""
    changes = [f"changed {change}" for change in list_changes(read_config(run), config)]
    delete_partial_files(run)
    differences = compare_robot(run, quadruped)
    write_json(run.config, _collect_settings(config, quadruped))
    heights = config.env.ground.file
    if heights is not None and heights != resolve_path(run.locate_heights(heights)):
        copy = read_bytes(heights)
        with open_atomic(run.locate_heights(heights)) as file:
            file.write(copy)
    return [*differences, *changes]


def _collect_settings(config: TrainConfig, quadruped: Quadruped) -> dict[str, Any]:
    """Return the content of config.json: settings, versions of packages and the robot's hash."""
    return {
        "config": to_dict(config),
        "versions": get_versions(),
        ROBOT_HASH: hash_robot(quadruped),
    }


def read_config(run: Run) -> TrainConfig:
    """Read the settings in a run's config.json; `UserError` if it is damaged."""
    try:
        content = json.loads(read_bytes(run.config))
        data, version = content["config"], content["versions"]["quadwalk"]
    except DAMAGE:
        raise UserError(f"{run.config} is damaged: expected JSON with a 'config'") from None
    return restore_config(data, run, f"{run.config}: config", version)


def restore_config(data: Any, run: Run, where: str, version: str = "0.1") -> TrainConfig:
    """Return the settings in `data`, JSON that quadwalk `version` wrote in the file `where`.

    They name the copies of robot and ground in `run`, and meshes where they were at first.
    """
    if isinstance(data, dict) and "task" not in data:
        raise UserError(
            f"{where} is of quadwalk {version} or before, which this version cannot read; expected "
            "a newer run: train it again, or evaluate it with that version"
        )
    config = from_dict(TrainConfig, data, run.path, where)
    if "suite" not in data:
        config = dataclasses.replace(config, suite=_derive_suite(config.env))
    robot, heights = config.robot, config.env.ground.file
    folders = tuple(dict.fromkeys((robot.urdf.parent, *robot.mesh_dirs)))
    if heights is not None and run.locate_heights(heights).exists():  # older runs have no copy
        heights = run.locate_heights(heights)
    return set_files(config, run.urdf, folders, heights)


def _derive_suite(config: EnvConfig) -> Suite:
    """Return the suite of evaluations for settings of an old version, which do not name one."""
    if not config.ground.flat:
        return "terrain"
    if config.reset.tumbled:
        return "standing"
    return "course" if config.command.turning is None else "commands"


def read_config_to_resume(run: Run) -> TrainConfig:
    """Return the settings that a run is resumed with unless flags change them.

    They are the run's, but for its time limit and for how it was shown and shared between
    processes.
    """
    return dataclasses.replace(
        read_config(run),
        name=None,
        runs=run.path.parent,
        minutes=None,
        quiet=False,
        watch=False,
        desk=False,
        distributed=DistributedConfig(),
    )


def read_config_to_replay(run: Run) -> TrainConfig:
    """Read the configuration of another run that repeats the changes made at the desk of `run`."""
    if not run.desk.exists():
        raise UsageError(
            f"--replay: {run.path} has no {run.desk.name}; expected a run trained with --desk"
        )
    return dataclasses.replace(read_config_to_resume(run), replay=str(resolve_path(run.path)))


def list_changes(before: TrainConfig, now: TrainConfig) -> list[str]:
    """Return the settings that differ, as "name: old -> new".

    Raises `UsageError` for a setting that cannot change in a run.
    """
    old, new = flatten(before), flatten(now)
    names = [n for n in {**old, **new} if old.get(n) != new.get(n) and n not in _FREE]
    for name in names:
        if name in _FIXED:
            flag = name.replace("_", "-")
            raise UsageError(f"--{flag} cannot change when a run is resumed: it is {old[name]}")
    return [f"{name}: {old.get(name)} -> {new.get(name)}" for name in names]


def compare_robot(run: Run, quadruped: Quadruped) -> tuple[str, ...]:
    """Return one warning if `quadruped` is not the robot that `run` was trained on, else none.

    For a run of an early version, which has no hash of its robot, there is no warning either.
    """
    try:
        trained = json.loads(read_bytes(run.config)).get(ROBOT_HASH)
    except (*DAMAGE, UserError):
        trained = None
    if trained is None or trained == hash_robot(quadruped):
        return ()
    return (
        f"warning: {run.path} was trained on another robot than it has now, in masses, joints, "
        "motors or shapes: expected the same robot.urdf, and mesh files where they were or in "
        f"{run.path}",
    )


def describe_training(config: TrainConfig, quadruped: Quadruped) -> dict[str, Any]:
    """Return all that decides what is trained, the same wherever its files are.

    `quadruped` is the robot. A run whose policy it begins with is there by its name.
    """
    parts = {name: to_dict(getattr(config, name)) for name in ("robot", "env", "ppo")}
    del parts["robot"]["mesh_dirs"]
    parts["robot"]["urdf"] = quadruped.urdf
    if config.env.ground.file is not None:
        parts["env"]["ground"]["file"] = hash_file(config.env.ground.file)
    model = quadruped.spec.copy()  # which has the meshes
    model.comment = ""  # that names the URDF's file
    init = config.init and Path(config.init).name
    return {**parts, "init": init, "model": write_xml(model), TASK_FILE: find_task_source(config)}
