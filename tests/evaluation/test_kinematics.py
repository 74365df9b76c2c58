"""Rotations and link poses against MuJoCo's, for the AlienGo and other people's quadrupeds."""

import mujoco
import numpy as np
import pytest

from quadwalk.evaluation.gait import compute_foot_poses
from quadwalk.evaluation.mcap.urdf import find_link_frames
from quadwalk.evaluation.metrics import to_roll_pitch_yaw, to_rotations
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import Quadruped, load_quadruped, make_quadruped
from quadwalk.robot.urdf import parse_urdf
from tests.robot import zoo
from tests.robot.robots import Walker, make_data, make_frame


def check_links(quadruped: Quadruped) -> None:
    """Links put together from frame to frame stand where MuJoCo's bodies and sites do."""
    model = quadruped.make_full_model()
    rng = np.random.default_rng(0)
    states = np.tile(quadruped.home, (3, 1))
    states[:, :3] += rng.normal(size=(3, 3))
    states[:, 3:7] = rng.normal(size=(3, 4))
    states[:, 7:] += rng.normal(size=(3, 12))
    frames = find_link_frames(quadruped)
    turns = frames.compute_rotations(states[:, 7:])
    centers, calves = compute_foot_poses(model, quadruped.feet, states)
    for row, state in enumerate(states):
        data = make_data(model, state)
        trunk = state[3:7] / np.linalg.norm(state[3:7])
        world = {quadruped.trunk: make_frame(state[:3], trunk)}
        for k, (link, parent) in enumerate(zip(frames.links, frames.parents, strict=True)):
            world[link] = world[parent] @ make_frame(frames.translation[k], turns[row, k])
        bodies = {model.body(k).name for k in range(1, model.nbody)}
        sites = {model.site(k).name for k in range(model.nsite)}
        assert bodies <= set(world) <= bodies | sites  # each moving link, and no unknown one
        for link, own in world.items():
            found = data.body(link) if link in bodies else data.site(link)
            np.testing.assert_allclose(own[:3, 3], found.xpos, atol=1e-9)
            np.testing.assert_allclose(own[:3, :3].ravel(), found.xmat, atol=1e-9)
        for k, foot in enumerate(quadruped.feet):
            np.testing.assert_allclose(centers[row, k], data.geom(foot).xpos)
            calf = model.body(model.geom(foot).bodyid[0]).name
            np.testing.assert_allclose(make_frame(0, calves[row, k])[:3, :3], world[calf][:3, :3])


def test_links_stand_where_mujoco_has_them(quadruped):
    check_links(quadruped)


def test_links_of_other_quadrupeds(reference_urdf):
    check_links(load_quadruped(reference_urdf))


@zoo.repeat_for(zoo.QUADRUPEDS)
def test_links_of_the_zoos_quadrupeds(urdf):
    check_links(load_quadruped(urdf, Options(meshes=False)))


def test_links_of_a_robot_that_was_turned():
    text = Walker(rpy=(0.0, 0.0, np.pi / 2)).text()
    quadruped = make_quadruped(parse_urdf(text))
    assert find_link_frames(quadruped).parents[0] == quadruped.trunk == "trunk_ahead"
    check_links(quadruped)


@pytest.mark.filterwarnings("error")
def test_angles_are_those_that_mujoco_turns_by():
    angles = np.random.default_rng(0).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (50, 3))
    quats = np.empty((50, 4))
    for quat, (roll, pitch, yaw) in zip(quats, angles, strict=True):
        mujoco.mju_euler2Quat(quat, [yaw, pitch, roll], "zyx")
    np.testing.assert_allclose(to_roll_pitch_yaw(3.0 * quats), angles, atol=1e-9)
    # Nose up: of roll and yaw only the sum is determined, and there is no warning of it.
    up = to_roll_pitch_yaw(np.array([[np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0]]))
    assert up[0, 1] == pytest.approx(-np.pi / 2)


def test_a_quaternion_without_length_is_no_rotation():
    quats = np.array([[0.0] * 4, [np.nan] * 4, [1e-200, 0, 0, 0], [0, 0, 0, 2.0]])
    turned = to_rotations(quats).apply([1.0, 2.0, 3.0])
    np.testing.assert_allclose(turned, [[1, 2, 3]] * 3 + [[-1, -2, 3]])
    assert to_roll_pitch_yaw(np.empty((0, 4))).shape == (0, 3)
