"""Settings to JSON and back, by name, and changed by name."""

import dataclasses
import functools
import json
import math
import operator
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadwalk.env import rewards as reward
from quadwalk.errors import UsageError, UserError
from quadwalk.settings.serialize import OLD_NAMES, change_settings, flatten, from_dict, to_dict
from quadwalk.settings.terms import Reward
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks, sprint


@pytest.mark.parametrize("name", list_tasks())
def test_a_task_comes_back_from_json(name):
    task = load_task(name)
    assert from_dict(TrainConfig, json.loads(json.dumps(to_dict(task))), Path()) == task


ODD = ["x", None, [], [None], {"a": [1]}, True, -1, 0.5, math.nan, [math.nan, 1.0], 1e300, 10**400]


def places(data: Any, *path: Any) -> Iterator[tuple[Any, ...]]:
    """Yield the place of everything in JSON data."""
    inner = data.items() if isinstance(data, dict) else enumerate(data)
    for key, part in inner:
        yield (*path, key)
        if isinstance(part, dict | list):
            yield from places(part, *path, key)


@pytest.mark.parametrize("odd", ODD, ids=lambda odd: repr(odd)[:9])
def test_any_value_in_any_place_fits_or_is_one_line_that_names_the_place(odd):
    def find_problem(data: Any) -> str | None:
        try:
            config = from_dict(TrainConfig, data, Path())
        except UserError as error:
            return str(error)
        return None if from_dict(TrainConfig, to_dict(config), Path()) == config else "changed"

    data = to_dict(load_task("rough"))
    for *path, last in places(data):
        group = functools.reduce(operator.getitem, path, data)
        old_value, group[last] = group[last], odd
        line = find_problem(data)
        setting = [key for key in (*path, last) if key not in ("params", "scale", *range(99))][-1]
        if line is not None:
            assert re.fullmatch(rf"config.*\b{setting.replace('_', '[-_]')}\b.{{9,250}}", line)
        group[last] = old_value


def test_what_belongs_together_is_changed_together():
    rates = {"ppo.min_learning_rate": 0.1, "ppo.max_learning_rate": 0.2}
    ppo = change_settings(sprint.TASK, rates).ppo
    assert (ppo.min_learning_rate, ppo.max_learning_rate) == (0.1, 0.2)
    with pytest.raises(UsageError, match=r"ppo\.min-learning-rate is 0\.1; expected at most"):
        change_settings(sprint.TASK, {"ppo.min_learning_rate": 0.1})


@pytest.mark.parametrize("name", list_tasks())
def test_every_setting_can_be_changed_by_the_name_that_it_has(name):
    task = load_task(name)
    for setting, value in flatten(task).items():
        if setting == "task" or setting.endswith(("function", "labels")):
            continue
        assert change_settings(task, {setting: value}) == task, setting


@given(scale=st.floats(-10, 10), speed=st.integers(1, 9))
def test_a_scale_and_a_parameter_of_a_term_are_changed_and_nothing_else(scale, speed):
    changes = {"env.reward.energy": scale, "env.reward.forward.max_speed": speed}
    config = change_settings(sprint.TASK, changes)
    assert config.env.reward["energy"].scale == scale
    assert config.env.reward["forward"].params == {"max_speed": float(speed)}
    before, after = flatten(sprint.TASK), flatten(config)
    assert {name for name in before if before[name] != after[name]} <= set(changes)
    assert list(after) == list(before)  # and in the same order, in which rewards are summed


def test_a_term_can_be_put_in_place_of_another_or_added():
    term = Reward(reward.alive, scale=3.0)
    config = change_settings(sprint.TASK, {"env.reward.fall": term, "env.reward.mine": term})
    assert config.env.reward["fall"] is config.env.reward["mine"] is term


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"env.reward.enrgy": 1.0}, "did you mean 'energy'"),
        ({"env.rewards.energy": 1.0}, "did you mean 'reward'"),
        ({"step": 1}, "did you mean 'steps'"),
        ({"env.reward.energy": "much"}, "env.reward.energy is 'much'; expected float"),
        ({"steps": "many"}, "steps is 'many'; expected int"),
        ({"steps": True}, "steps is True; expected int"),
        ({"steps": 0}, "--steps is 0; expected 1 or more"),
        ({"steps.energy": 1.0}, "steps.energy"),
        ({"env.engine": "bullet"}, "env.engine is 'bullet'; expected fast or mjx"),
        ({"env.physics_dt": 1.0}, "env.physics-dt"),
    ],
)
def test_a_change_that_cannot_be_is_said_in_one_line(changes, message):
    with pytest.raises(UserError, match=message):
        change_settings(sprint.TASK, changes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data.pop("ppo"), "ppo"),
        (lambda data: data.update(new=1), "config.new is not a setting of this version"),
        (lambda data: data.update(env=3), "config.env is 3; expected a group of settings"),
        (lambda data: data["env"].update(gravity="down"), "config.env.gravity is 'down'"),
        (lambda data: data["env"]["reward"]["energy"].update(function="os:system"), "os:system"),
    ],
)
def test_json_that_does_not_fit_is_named(change, message):
    data = to_dict(sprint.TASK)
    change(data)
    with pytest.raises(UserError, match=message):
        from_dict(TrainConfig, data, Path())


def test_a_notebooks_function_cannot_be_kept():
    term = Reward(lambda robot, step: 1.0, scale=1.0)
    env = dataclasses.replace(sprint.TASK.env, reward={"mine": term})
    with pytest.raises(UsageError, match="task's file"):
        to_dict(dataclasses.replace(sprint.TASK, env=env))


def test_runs_of_before_settings_were_renamed_are_read():
    task = load_task("walk")
    data = to_dict(task)
    env, ppo = data["env"], data["ppo"]
    for part, group in ((ppo, "PPOConfig"), (env["randomization"], "RandomizationConfig")):
        for old, new in OLD_NAMES[group].items():
            part[old] = part.pop(new)
    for group in ("observation", "critic"):
        names = {"joint_pos": "position", "joint_vel": "speed"}
        data["env"][group] = {names.get(k, k): v for k, v in data["env"][group].items()}
    env["randomisation"] = env.pop("randomization")
    assert from_dict(TrainConfig, data, Path()) == task
