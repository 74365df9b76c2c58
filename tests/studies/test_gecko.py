"""The study of the gecko: what its variants exchange, and what it measures."""

import dataclasses
import json

import mujoco
import numpy as np
import pytest

from quadwalk.evaluation.gait import measure_gait
from quadwalk.evaluation.rollout import Rollout
from quadwalk.settings.serialize import flatten
from quadwalk.task_files import load_task
from studies.gecko.gait import compute_figures, find_body_contact, find_footfalls, sample_frames
from studies.gecko.study import CAUSES, OTHER, RESULTS, make_variants


def list_changes(variant, base) -> set[str]:
    """Return the names of settings that differ between two flat configurations.

    Names that only one of them has are among these.
    """
    return {name for name in {**variant, **base} if variant.get(name) != base.get(name)}


@pytest.mark.parametrize("task", ["blog", "sprint"])
def test_each_variant_takes_one_thing_from_the_other_task(task):
    base, other = (flatten(load_task(name)) for name in (task, OTHER[task]))
    earlier_names = set()
    for cause, settings in CAUSES.items():
        variant = flatten(make_variants()[f"{task}, {cause}"])
        names = list_changes(variant, base)
        assert names
        assert not names & list_changes(variant, other)
        assert all(any(f"{name}.".startswith(f"{s}.") for s in settings) for name in names)
        assert not names & earlier_names  # no two causes share a setting
        earlier_names |= names
    assert list_changes(flatten(make_variants()[f"{task}, all of them"]), base) == earlier_names


def test_action_0_alone_is_moved_to_the_standing_pose(quadruped):
    base, variant = load_task("blog"), make_variants()["blog, action 0"]
    bounds = [f"env.action.{part}_{end}" for part in ("thigh", "calf") for end in ("low", "high")]
    assert list_changes(flatten(variant), flatten(base)) == set(bounds)
    # A joint is where action 0 puts it, so that the limit of a step does not matter.
    standing = variant.env.action(None, np.zeros(12), quadruped.home[7:])
    np.testing.assert_allclose(standing, quadruped.home[7:], atol=1e-6)

    def reach(config):
        return config.env.action.params["thigh_high"] - config.env.action.params["thigh_low"]

    assert reach(variant) == pytest.approx(reach(base))


def still(quadruped, qpos, contact) -> Rollout:
    """Return a rollout of as many steps as `contact` (T, 4) has, in one pose."""
    steps = len(contact)
    return Rollout(
        control_dt=0.02, seed=0, episode=0, end="time limit",
        qpos=np.tile(qpos, (steps + 1, 1)), qvel=np.zeros((steps + 1, 18)),
        action=np.zeros((steps, 12)), target=np.zeros((steps, 12)), torque=np.zeros((steps, 12)),
        energy=np.zeros(steps), observation=np.zeros((steps, 1)), observation_names=("nothing",),
        contact=np.asarray(contact, bool), reward_terms={}, reward=np.zeros(steps),
    )  # fmt: skip


def test_what_lies_on_the_floor_is_told_from_what_stands(quadruped):
    standing, lying, flying = (quadruped.home.copy() for _ in range(3))
    standing[2] -= 0.001
    lying[2], lying[7:] = 0.056, np.tile([0.0, 1.5, -2.7], 4)  # half the trunk's height
    flying[2] += 0.2
    down, up = np.ones((5, 4)), np.zeros((5, 4))
    for qpos, contact, body, flight in (
        (standing, down, 0.0, 0.0), (lying, up, 1.0, 0.0), (flying, up, 0.0, 1.0),
    ):  # fmt: skip
        rollout = still(quadruped, qpos, contact)
        assert find_body_contact(rollout, quadruped).mean() == body
        figures = compute_figures(measure_gait(rollout, quadruped), rollout, quadruped)
        assert figures["body_contact"] == body
        assert figures["flight"] == flight
        assert figures["height"] == pytest.approx(qpos[2] / quadruped.home[2])


def test_sprawl_and_heading_are_angles_in_degrees(quadruped):
    qpos = quadruped.home.copy()
    qpos[7::3] += np.radians([20.0, -20.0, 40.0, 0.0]) - quadruped.home[7::3]
    mujoco.mju_axisAngle2Quat(qpos[3:7], np.array([0.0, 0.0, 1.0]), np.radians(-30.0))
    rollout = still(quadruped, qpos, np.ones((5, 4)))
    figures = compute_figures(measure_gait(rollout, quadruped), rollout, quadruped)
    assert figures["sprawl"] == pytest.approx(20.0)
    assert figures["heading"] == pytest.approx(30.0)


def test_frames_and_footfalls_are_those_of_the_rollout(quadruped):
    contact = np.zeros((150, 4), bool)
    contact[60:90, 1] = True  # of the last 100 steps the 11th to the 40th
    contact[140:, 3] = True
    rollout = still(quadruped, quadruped.home, contact)
    rollout = dataclasses.replace(rollout, qpos=rollout.qpos + np.arange(151)[:, None])
    frames = np.array(sample_frames(rollout))
    rows = frames[:, 0] - quadruped.home[0]
    np.testing.assert_allclose(rows, [62, 68, 72, 78, 82, 88], atol=1.01)  # 25 steps about 75
    np.testing.assert_allclose(find_footfalls(rollout)[1], [[0.2, 0.8]])
    np.testing.assert_allclose(find_footfalls(rollout)[3], [[1.8, 2.0]])
    assert find_footfalls(rollout)[0] == []


def test_the_results_are_of_the_variants_there_are():
    results = json.loads(RESULTS.read_text())
    keys = {(result["variant"], result["seed"]) for result in results}
    assert len(keys) == len(results)
    assert {variant for variant, _ in keys} == set(make_variants())
