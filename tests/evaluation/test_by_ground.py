"""Evaluation on uneven ground: figures by kind and difficulty, and how ground is drawn."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from quadwalk.env.env import QuadrupedEnv, make_task_robot
from quadwalk.evaluation.gait import measure_gait
from quadwalk.evaluation.load import LoadedRun, make_unseen_ground
from quadwalk.evaluation.mcap.scene import GROUND_MARGIN, GROUND_NODES, draw_ground
from quadwalk.evaluation.mcap.write import write_mcap
from quadwalk.evaluation.report.pictures import draw_film_strip
from quadwalk.evaluation.rollout import roll_out
from quadwalk.evaluation.suites.terrain import PACE, draw_terrain, measure_terrain, print_terrain
from quadwalk.learn.acting import Policy
from quadwalk.runs.directory import Run
from quadwalk.settings.environment import NO_RANDOMIZATION
from quadwalk.tasks import obstacles, rough, sprint, walk
from quadwalk.terrain.heightfield import Heightfield, make_field
from tests.evaluation.conftest import make_glide_poses, read_messages


@jax.tree_util.register_static
class Walk(SimpleNamespace):
    """An environment of which little is needed."""

    __hash__ = object.__hash__


def step_ahead(state: State, _) -> State:
    """Take a step of 1 cm ahead, with one step less left."""
    left = state.info["left"] - 1
    info = {"left": left, "end": (left == 0).astype(int)}
    return state.replace(obs=state.obs.at[0].add(0.01), info=info)


@pytest.mark.parametrize("room", [1, 2, 3, 7, 100])
def test_each_episode_goes_on_to_its_own_end_whatever_there_is_room_for(room):
    lasts = np.array([3, 120, 50, 1, 51, 9, 70, 100, 3, 1])  # steps of each episode
    env = Walk(
        engine="mujoco",
        ends=("running", "time limit"),
        config=SimpleNamespace(episode_steps=120),
        terrain=None,
        step=step_ahead,
    )
    act = jax.tree_util.Partial(lambda observation: observation)
    info = {"left": jnp.asarray(lasts), "end": jnp.zeros_like(lasts)}
    starts = State(None, jnp.arange(10.0)[:, None], None, None, {}, info)
    reported: list[int] = []
    places = roll_out(
        env, act, starts, lambda env, before, action, after: after.obs[:, 0], room, reported.append
    )
    actual = {number: (end, x) for number, end, x in places}
    assert sorted(actual) == list(range(len(lasts)))
    for number, (end, x) in actual.items():
        assert end == "time limit"
        expected = number + 0.01 * np.arange(1, lasts[number] + 1)
        np.testing.assert_allclose(x, expected, atol=1e-4)
    assert reported == sorted(reported)
    assert reported[-1] == 120


def make_results(commanded: bool) -> dict:
    cells = [
        {
            "kind": kind,
            "difficulty": difficulty,
            "success": 0.25 * (1 + row + column),
            "arrived": 0.25,
            "speed": {"mean": 0.5 + column, "ci95": None},
            "velocity_error": {"mean": 0.125, "ci95": 0.01} if commanded and row else None,
        }
        for row, kind in enumerate(("flat", "stairs_up"))
        for column, difficulty in enumerate((0.0, 1.0))
    ]
    return {
        "kinds": ["flat", "stairs_up"],
        "difficulties": [0.0, 1.0],
        "episodes": 4,
        "command": PACE if commanded else None,
        "cells": cells,
    }


@pytest.mark.parametrize("commanded", [True, False])
def test_the_map_and_the_table_show_every_cell(commanded, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    figure = draw_terrain(make_results(commanded), "a run")
    figure.draw_without_rendering()
    assert [axes.get_title("left") for axes in figure.axes] == [
        *("success, %", "speed, m/s"), *["velocity error, m/s"] * commanded,
    ]  # fmt: skip
    success = figure.axes[0]
    np.testing.assert_allclose(success.images[0].get_array(), [[25, 50], [50, 75]])
    assert [text.get_text() for text in success.texts] == ["25", "50", "50", "75"]
    print_terrain(make_results(commanded))
    output = capsys.readouterr().out
    for words in ("difficulty 0 ", "difficulty 1 ", "stairs up", "% success", "% arrival", "m/s"):
        assert words in output
    assert ("0.125 ± 0.010" in output) == commanded


@pytest.fixture(scope="module")
def loaded(quadruped) -> LoadedRun:
    """Return a policy that holds still, on ground of two kinds, for a tenth of a second."""
    ground = make_unseen_ground(rough.TASK.env.ground, 0)
    ground = dataclasses.replace(ground, kinds=("flat", "blocks"), tile=(3.0, 3.0))
    task = dataclasses.replace(
        walk.TASK.env, episode_seconds=0.1, randomization=NO_RANDOMIZATION, ground=ground
    )
    env = QuadrupedEnv(quadruped, task)
    act = jax.tree_util.Partial(lambda observation: 0.0 * observation[..., :12])
    policy = Policy(act, walk.TASK, quadruped.joints, env.policy_size, 0)
    return LoadedRun(Run(Path()), Path(), policy, env, "0")


@pytest.mark.parametrize("difficulty", [(0.0, 1.0), (0.7, 0.7)])
def test_a_cell_has_the_figures_of_episodes_on_its_own_tiles(loaded, monkeypatch, difficulty):
    task = loaded.env.config
    ground = dataclasses.replace(task.ground, difficulty=difficulty)
    task = dataclasses.replace(task, ground=ground, episode_seconds=4.0)
    loaded = dataclasses.replace(loaded, env=QuadrupedEnv(loaded.env.quadruped, task))
    # In the frame of the heading, m/s: as commanded; too slow and to the left; a fall.
    kinds = [
        ((PACE, 0.0), 120, "time limit"),
        ((0.4, 0.4), 200, "time limit"),
        ((0.1, 0.0), 30, "tipped"),
    ]
    used_tiles = []

    def glide(env, policy, starts, *_):
        """Yield episodes of these kinds in turn, in place of simulated ones."""
        for number, start in enumerate(np.asarray(starts.pipeline_state.qpos, float)):
            used_tiles.append(env.terrain.tiles[int(starts.pipeline_state.tile[number])])
            velocity, steps, end = kinds[number % 3]
            yield number, end, make_glide_poses(start, np.tile([*velocity, 0.0], (steps, 1)))

    monkeypatch.setattr("quadwalk.evaluation.rollout.roll_out", glide)
    actual = measure_terrain(loaded, levels=3, episodes=18, seed=0)
    assert len(actual["cells"]) == len(actual["kinds"]) * len(actual["difficulties"])
    for number, cell in enumerate(actual["cells"]):
        tiles = used_tiles[18 * number : 18 * (number + 1)]
        assert {tile.kind for tile in tiles} == {cell["kind"]}
        assert {tile.difficulty for tile in tiles} == {cell["difficulty"]}
        assert len({tile.start for tile in tiles}) >= 16
        assert cell["success"] == pytest.approx(2 / 3)
        assert cell["arrived"] == pytest.approx(1 / 3)
        assert cell["speed"]["mean"] == pytest.approx((PACE + 0.4 + 0.1) / 3)
        # The last was too short to be judged.
        assert cell["velocity_error"]["mean"] == pytest.approx((0.0 + np.hypot(0.3, 0.4)) / 2)
    json.dumps(actual)


def test_a_policy_is_measured_in_every_cell(loaded):
    actual = measure_terrain(loaded, levels=2, episodes=2, seed=0)
    assert [(cell["kind"], cell["difficulty"]) for cell in actual["cells"]] == [
        ("flat", 0.0), ("flat", 1.0), ("blocks", 0.0), ("blocks", 1.0),
    ]  # fmt: skip
    for cell in actual["cells"]:
        assert (cell["success"], cell["arrived"]) == (1.0, 0.0)
        assert abs(cell["speed"]["mean"]) < 0.6
        assert cell["velocity_error"] is None


def test_both_tasks_have_a_noisy_sight_and_a_curriculum():
    for task in (rough.TASK, obstacles.TASK):
        assert task.env.observation["height_scan"].noise > 0
        assert task.env.ground.curriculum
        assert task.env.contacts == "knees"
        assert task.env.randomization.enabled


def test_the_ground_of_a_recording_is_the_field_around_the_path():
    rng = np.random.default_rng(0)
    field = make_field(rng.uniform(-0.2, 0.2, (201, 301)).astype(np.float32), 0.05)
    path = np.array([[-1.0, 0.5], [2.0, -0.5]])
    (entity,) = SceneUpdate.FromString(draw_ground(field, path)).entities
    (shape,) = entity.triangles
    assert (entity.id, entity.frame_id) == ("ground", "world")
    points = np.array([(p.x, p.y, p.z) for p in shape.points])
    np.testing.assert_allclose(points[:, 2], field.compute_height(points[:, :2]), atol=0.03)
    reached = [path.min(axis=0) - GROUND_MARGIN, path.max(axis=0) + GROUND_MARGIN]
    actual = [points[:, :2].min(axis=0), points[:, :2].max(axis=0)]
    np.testing.assert_allclose(actual, reached, atol=0.1)
    corners = points[np.array(shape.indices).reshape(-1, 3)]
    edges = corners[:, 1:, :2] - corners[:, :1, :2]
    areas = 0.5 * (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    assert np.all(areas > 0)  # seen from above
    assert areas.sum() == pytest.approx(np.prod(np.ptp(points[:, :2], axis=0)), rel=1e-6)
    assert len(shape.colors) == len(points) <= GROUND_NODES


@pytest.fixture(scope="module")
def raised(quadruped):
    """Return the robot on a plateau half a meter high."""
    plateau = Heightfield(np.full((41, 41), 0.5, np.float32), 0.5, (-10.0, -10.0))
    return make_task_robot(quadruped, sprint.TASK.env, plateau)


@pytest.fixture
def lifted(trot):
    return dataclasses.replace(trot, qpos=trot.qpos + 0.5 * np.eye(19)[2])


def test_a_recording_has_the_ground_once_and_the_path_on_it(lifted, raised, tmp_path):
    path = tmp_path / "episode.mcap"
    write_mcap(path, lifted, raised, {})
    actual = read_messages(path)
    ((when, ground),) = actual["/ground"]
    assert when == 0
    assert {point.z for point in ground.entities[0].triangles[0].points} == {0.5}
    for _, scene in actual["/scene"]:
        parts = {entity.id: entity for entity in scene.entities}
        assert not parts["ground"].lines[0].points
        heights = [point.z for point in parts["path"].lines[0].points]
        np.testing.assert_allclose(heights, 0.51, atol=1e-3)


def test_pictures_follow_the_ground(lifted, trot, raised, quadruped):
    def find_orange(rollout, robot):
        strip = draw_film_strip(rollout, robot, width=120, height=80).astype(int)
        red, green, blue = strip[..., 0], strip[..., 1], strip[..., 2]
        return (red > 150) & (green < 0.7 * red) & (blue < 0.3 * red)

    on_floor, above = find_orange(trot, quadruped), find_orange(lifted, raised)
    assert on_floor.mean() > 0.01
    assert (on_floor != above).mean() < 0.1 * on_floor.mean()


def test_heights_of_a_gait_are_above_ground(quadruped, trot, lifted, raised):
    on_floor, above = measure_gait(trot, quadruped), measure_gait(lifted, raised)
    np.testing.assert_allclose(above.swing_height, on_floor.swing_height, atol=1e-5)
    np.testing.assert_allclose(above.body_height, on_floor.body_height, atol=1e-5)
