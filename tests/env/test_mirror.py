"""The sagittal mirror: which number of an observation and an action is the image of which."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.reflections import FEET, SCALAR, mirrors
from quadwalk.errors import UserError
from quadwalk.robot.mirror import NotSymmetric, find_robot_mirror, make_mirror
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.settings.terms import Observation
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks, rough, run, sprint
from tests.robot import zoo

SIDES = {"FR": "FL", "FL": "FR", "RR": "RL", "RL": "RR"}


@pytest.mark.parametrize("name", list_tasks())
def test_every_task_has_a_mirror_and_mirroring_twice_changes_nothing(quadruped, name):
    env = QuadrupedEnv(quadruped, load_task(name).env)
    for mirror, size in zip(env.mirrors, (env.observation_size, 12), strict=True):
        x = np.random.default_rng(0).normal(size=size).astype(np.float32)
        assert not np.array_equal(mirror(x), x)
        np.testing.assert_array_equal(mirror(mirror(x)), x)


def test_the_mirror_of_the_alien_go_is_what_its_names_say(quadruped):
    env = QuadrupedEnv(quadruped, run.TASK.env)
    names = [*env.sensors.names, *(f"critic_{name}" for name in env.sensors.critic_names)]
    odd = ("velocity_y", "gravity_y", "heading", "angular_velocity_x", "angular_velocity_z")
    for i, name in enumerate(names):
        if "conditions" in name or "contacts" in name:
            continue
        side = next((leg for leg in SIDES if f"_{leg}_" in name), None)
        image = name if side is None else name.replace(f"_{side}_", f"_{SIDES[side]}_")
        plain = name.removeprefix("critic_").partition("[")[0]
        flips = plain in odd or (side is not None and "hip" in name)
        assert names[env.mirrors.observation.source[i]] == image
        assert env.mirrors.observation.sign[i] == (-1 if flips else 1), name
    hips = np.arange(12) % 3 == 0
    np.testing.assert_array_equal(env.mirrors.action.sign, np.where(hips, -1, 1))
    np.testing.assert_array_equal(env.mirrors.action.source, [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8])


def test_a_scan_is_reversed_from_right_to_left(quadruped):
    env = QuadrupedEnv(quadruped, rough.TASK.env)
    scan = [i for i, name in enumerate(env.sensors.names) if name.startswith("height_scan")]
    expected = np.array(scan).reshape(13, 7)[:, ::-1].ravel()
    np.testing.assert_array_equal(env.mirrors.observation.source[scan], expected)
    clock = [env.sensors.names.index(f"clock_{part}") for part in ("sine", "cosine")]
    np.testing.assert_array_equal(env.mirrors.observation.sign[clock], -1)


@pytest.mark.parametrize(
    ("source", "sign"), [([1, 2, 0], [1, 1, 1]), ([1, 0], [1, -1]), ([0, 0], [1, 1]), ([0], [2])]
)
def test_what_is_not_itself_again_when_mirrored_twice_is_no_mirror(source, sign):
    with pytest.raises(ValueError, match="mirror"):
        make_mirror(source, sign)


@zoo.repeat_for(zoo.QUADRUPEDS)
def test_robots_of_the_zoo_are_their_own_mirror_image(urdf):
    quadruped = load_quadruped(urdf, Options(meshes=False))
    robot_mirror = find_robot_mirror(
        quadruped, quadruped.make_training_model(0.004, contacts="all")
    )
    assert robot_mirror.feet.source.tolist() == [1, 0, 3, 2]
    # HyQ's hips on both sides turn outwards.
    assert (robot_mirror.joints.sign[::3] == (1 if "hyq" in urdf.stem else -1)).all()


def _mass(body):
    body.mass *= 1.1


def _axis(body):
    body.joints[0].axis = [0.0, 0.99, 0.14]


@pytest.mark.parametrize(("change", "reason"), [(_mass, "mass of '"), (_axis, "axis of '")])
def test_a_robot_with_one_leg_changed_has_no_mirror_and_says_why(quadruped, change, reason):
    spec = quadruped.spec.copy()
    change(spec.joint(quadruped.joints[1]).parent)
    env = QuadrupedEnv(dataclasses.replace(quadruped, spec=spec), sprint.TASK.env)
    with pytest.raises(NotSymmetric, match=rf"{reason}(FR|FL)"):
        env.mirrors  # noqa: B018


def custom_observation(robot, state):
    """Return a user's own observation, which does not state how it mirrors."""
    return jnp.zeros(2)


@mirrors(FEET, SCALAR)
def wrong(robot, state):
    """Return four numbers; the mirror of this observation is for five."""
    return jnp.zeros(4)


@pytest.mark.parametrize("group", ["observation", "critic"])
def test_a_term_that_does_not_say_is_named_and_one_of_another_size_refused(quadruped, group):
    def env_with(function):
        parts = {**getattr(run.TASK.env, group), "own": Observation(function)}
        return QuadrupedEnv(quadruped, dataclasses.replace(run.TASK.env, **{group: parts}))

    with pytest.raises(NotSymmetric, match=f"{group} 'own' does not say how it mirrors"):
        env_with(custom_observation).mirrors  # noqa: B018
    with pytest.raises(UserError, match=rf"{group} 'own' has 4 numbers, .* how 5 mirror"):
        env_with(wrong).mirrors  # noqa: B018
