"""Link poses against MuJoCo's, for the AlienGo and other people's quadrupeds."""

import numpy as np

from quadwalk.evaluation.gait import compute_foot_poses
from quadwalk.evaluation.mcap.urdf import find_link_frames
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import Quadruped, load_quadruped, make_quadruped
from quadwalk.robot.urdf import parse_urdf
from tests.robot import zoo
from tests.robot.robots import Walker, make_data, make_frame


def check_links(quadruped: Quadruped) -> None:
    """Assert that links, joined frame by frame, are where MuJoCo's bodies and sites are."""
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
        for link, pose in world.items():
            actual = data.body(link) if link in bodies else data.site(link)
            np.testing.assert_allclose(pose[:3, 3], actual.xpos, atol=1e-9)
            np.testing.assert_allclose(pose[:3, :3].ravel(), actual.xmat, atol=1e-9)
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
    text = Walker(rpy=(0.0, 0.0, np.pi / 2)).to_text()
    quadruped = make_quadruped(parse_urdf(text))
    assert find_link_frames(quadruped).parents[0] == quadruped.trunk == "trunk_ahead"
    check_links(quadruped)
