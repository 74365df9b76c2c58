from dataclasses import replace

import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.env.actions import about_home, feet_alike
from quadwalk.tasks import blog


def test_targets_lie_about_the_home_pose_and_within_the_joints_limits(env):
    robot, anywhere = env.robot, jnp.full(12, 9.0)
    for hip, thigh, calf, action, expected in [
        (0.3, 0.9, 0.9, 0.0, robot.home_joints),
        (0.1, 0.2, 0.3, -1.0, robot.home_joints - np.tile([0.1, 0.2, 0.3], 4)),
        (5.0, 5.0, 5.0, 1.0, robot.upper),
        (5.0, 5.0, 5.0, -1.0, robot.lower),
    ]:
        reach = {"hip": hip, "thigh": thigh, "calf": calf}
        found = about_home(robot, jnp.full(12, action), anywhere, **reach)
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_feet_go_wherever_those_of_legs_with_other_knees_do(env):
    """By MuJoCo: of hind legs bent the other way, whose thighs are as long as their calves."""
    reach = {"hip": 0.3, "thigh": 0.9, "calf": 0.8}
    free = replace(env.robot, lower=np.full(12, -np.inf), upper=np.full(12, np.inf))
    turn = np.eye(12)
    for thigh, calf in [(7, 8), (10, 11)]:
        turn[thigh, calf], turn[calf, calf] = 1.0, -1.0
    home = free.home.copy()
    home[7:] = turn @ home[7:]
    ahead = np.array([False, False, True, True])
    other = replace(free, home=home, knees_ahead=ahead)

    def feet(joints):
        data = mujoco.MjData(env.mj_model)
        data.qpos[:] = free.home
        data.qpos[7:] = joints
        mujoco.mj_kinematics(env.mj_model, data)
        return [data.geom(name).xpos.copy() for name in env.quadruped.feet]

    for corner in np.random.default_rng(0).choice([-1.0, 1.0], (8, 12)):
        there = feet_alike(free, corner, free.home_joints, **reach)
        joints = turn @ np.asarray(there)
        most = np.asarray(feet_alike(other, np.ones(12), home[7:], **reach)) - home[7:]
        action = (joints - home[7:]) / most
        assert np.max(np.abs(action)) < 1.0 + 1e-6
        targets = feet_alike(other, action, home[7:], **reach)
        np.testing.assert_allclose(feet(targets), feet(there), atol=1e-4)


def test_targets_between_bounds_and_near_the_joint(env):
    lows, highs = (-1.0, 0.0, -2.0), (1.0, 2.0, -1.0)
    names = ("hip", "thigh", "calf")
    bounds = {f"{name}_low": low for name, low in zip(names, lows, strict=True)}
    bounds |= {f"{name}_high": high for name, high in zip(names, highs, strict=True)}

    def targets(action, joints, step_limit):
        action, joints = jnp.full(12, action), jnp.full(12, joints)
        return blog.between_bounds(env.robot, action, joints, **bounds, step_limit=step_limit)

    for action, expected in [(-1, lows), (0, (0, 1, -1.5)), (1, highs), (0.5, (0.5, 1.5, -1.25))]:
        np.testing.assert_allclose(targets(action, 0.0, 9.0), np.tile(expected, 4), rtol=1e-6)
    for joints, expected in [(-5.0, -4.9), (5.0, 4.9)]:
        np.testing.assert_allclose(targets(1.0, joints, 0.1), expected, rtol=1e-6)
