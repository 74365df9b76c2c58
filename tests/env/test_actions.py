"""Action maps: targets about the home pose, and feet that go where those of other legs do."""

from dataclasses import replace

import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.env.actions import about_home, feet_alike


def test_targets_lie_about_the_home_pose_and_within_the_joints_limits(env):
    robot = env.robot
    for hip, thigh, calf, action, expected in [
        (0.3, 0.9, 0.9, 0.0, robot.home_joints),
        (0.1, 0.2, 0.3, -1.0, robot.home_joints - np.tile([0.1, 0.2, 0.3], 4)),
        (5.0, 5.0, 5.0, 1.0, robot.upper),
        (5.0, 5.0, 5.0, -1.0, robot.lower),
    ]:
        reach = {"hip": hip, "thigh": thigh, "calf": calf}
        targets = about_home(robot, jnp.full(12, action), **reach)
        np.testing.assert_allclose(targets, expected, rtol=1e-6)


def test_feet_go_wherever_those_of_legs_with_other_knees_do(env):
    """Check by MuJoCo with hind legs that are bent the other way.

    Thighs are as long as calves, so that both kinds of legs reach the same points.
    """
    reach = {"hip": 0.3, "thigh": 0.9, "calf": 0.8}
    free = replace(env.robot, lower=np.full(12, -np.inf), upper=np.full(12, np.inf))
    turn = np.eye(12)
    for thigh, calf in [(7, 8), (10, 11)]:
        turn[thigh, calf], turn[calf, calf] = 1.0, -1.0
    home = free.home.copy()
    home[7:] = turn @ home[7:]
    ahead = np.array([False, False, True, True])
    other = replace(free, home=home, knees_ahead=ahead)

    def place_feet(joints):
        data = mujoco.MjData(env.mj_model)
        data.qpos[:] = free.home
        data.qpos[7:] = joints
        mujoco.mj_kinematics(env.mj_model, data)
        return [data.geom(name).xpos.copy() for name in env.quadruped.feet]

    for corner in np.random.default_rng(0).choice([-1.0, 1.0], (8, 12)):
        there = feet_alike(free, corner, **reach)
        joints = turn @ np.asarray(there)
        most = np.asarray(feet_alike(other, np.ones(12), **reach)) - home[7:]
        action = (joints - home[7:]) / most
        assert np.max(np.abs(action)) < 1.0 + 1e-6
        targets = feet_alike(other, action, **reach)
        np.testing.assert_allclose(place_feet(targets), place_feet(there), atol=1e-4)
