"""A mistake in a term of a user's own file: one line that says where it is."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import pytest

import quadwalk
from quadwalk.env import observations
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.settings.terms import Observation
from quadwalk.task_files import load_task
from quadwalk.tasks import sprint

TASK = """\
import dataclasses
from quadwalk.settings.terms import ActionMap, Observation, Reward, Termination
from quadwalk.tasks import sprint

def mine({inputs}):
    {body}

TERM = {term}
ENV = sprint.TASK.env
TASK = dataclasses.replace(sprint.TASK, task="mine", env=dataclasses.replace(ENV, {place}))
"""
KINDS = {
    "reward": ("robot, step", "Reward(mine, scale=1.0)", 'reward={"own": TERM}'),
    "termination": ("robot, step", "Termination(mine)", 'termination={"own": TERM}'),
    "observation": ("robot, state", "Observation(mine)", 'observation={"own": TERM}'),
    "critic": ("robot, state", "Observation(mine)", 'critic={"own": TERM}'),
    "action": ("robot, action, joints", "ActionMap(mine)", "action=TERM"),
}


def own_task(folder, kind: str, body: str, inputs: str | None = None):
    """Return a task with one term of its own, which is in mine.py of `folder`."""
    usual, term, place = KINDS[kind]
    text = TASK.format(inputs=inputs or usual, body=body, term=term, place=place)
    (folder / "mine.py").write_text(text)
    return load_task(folder / "mine.py")


@pytest.mark.parametrize(
    ("kind", "body", "message"),
    [
        ("reward", "return step.qpos", "5: the reward 'own' gives an array of shape (19,); expected"
         " a number"),
        ("reward", "pass", "5: the reward 'own' gives a NoneType; expected a number"),
        ("reward", "return step.speed", "6: the reward 'own' does not give a number: "
         "AttributeError: 'Step' object has no attribute 'speed'"),
        ("reward", "return 1.0 if step.qpos[2] > 0.1 else 0.0", "6: the reward 'own' does not give "
         "a number: TracerBoolConversionError: "),
        ("termination", "return step.soles[:, 2] > 0.1", "5: the termination 'own' gives an array "
         "of shape (4,); expected a number"),
        ("observation", "return state.qpos.reshape(19, 1)", "5: the observation 'own' gives an "
         "array of shape (19, 1); expected a number or a vector"),
        ("critic", "return [state.qpos[0], state.qpos[1]]", "5: the observation 'own' gives a list;"
         " expected a number or a vector"),
        ("action", "return action[:3]", "5: the term 'mine' gives an array of shape (3,); expected "
         "12 joint targets"),
        ("action", "return robot.home + action", "6: the term 'mine' does not give 12 joint "
         "targets: TypeError: add got incompatible shapes"),
    ],
)  # fmt: skip
def test_it_is_one_line_with_the_terms_name_its_place_and_what_is_expected(
    tmp_path, quadruped, kind, body, message
):
    task = own_task(tmp_path, kind, body)

    def step(key):
        env = QuadrupedEnv(quadruped, task.env)
        return env.step(env.reset(key), jnp.zeros(12))

    with pytest.raises(UserError, match=re.escape(f"{tmp_path}/mine.py, line {message}")):
        jax.eval_shape(step, jax.random.PRNGKey(0))


def test_a_parameter_that_a_term_of_the_package_cannot_have_is_one_line_too(quadruped):
    sizes = {"length": 1.0, "width": 1.0, "spacing": 0.0, "reach": 1.0}
    parts = {"scan": Observation(observations.height_scan, sizes)}
    with pytest.raises(UserError, match=r"observation 'scan' does not give .*: ZeroDivisionError"):
        QuadrupedEnv(quadruped, dataclasses.replace(sprint.TASK.env, observation=parts))


def test_it_leaves_no_run_behind(tmp_path):
    task = own_task(tmp_path, "reward", "return 1.0", inputs="robot")
    with pytest.raises(
        UserError, match=r"mine\.py, line 5: the reward 'own' .* takes 1 positional"
    ):
        quadwalk.train(task, runs=tmp_path / "runs", name="dog", envs=16, devices=1)
    assert not list(tmp_path.glob("runs/*"))
