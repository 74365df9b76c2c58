"""Episodes of the blog post's task: 37 numbers seen, targets near the joints, 240 steps in 1 s."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.gait import measure_gait
from quadwalk.evaluation.mcap.foot_forces import add_foot_forces
from quadwalk.evaluation.mcap.write import write_mcap
from quadwalk.evaluation.rollout import simulate_episodes
from quadwalk.task_files import load_task

STEPS = 50
LOWER = np.tile([-1.2217, -1.0, -2.77507], 4)
UPPER = np.tile([1.2217, 1.0, -0.645772], 4)


@pytest.fixture(scope="module")
def env(quadruped) -> QuadrupedEnv:
    config = dataclasses.replace(load_task("blog").env, episode_seconds=STEPS / 240)
    return QuadrupedEnv(quadruped, config, "mujoco")


@pytest.fixture(scope="module")
def rollout(env):
    """Return a rollout in MuJoCo C of a policy that throws the legs about."""
    weights = jax.random.normal(jax.random.PRNGKey(1), (37, 12))
    policy = jax.tree_util.Partial(lambda w, obs: jnp.tanh(obs @ w), weights)
    (rollout,) = simulate_episodes(env, policy, 1, seed=0)
    return rollout


def test_a_rollout_has_the_targets_that_were_obeyed(rollout):
    assert (rollout.steps, rollout.end) == (STEPS, "time limit")
    q = rollout.qpos[:-1, 7:]
    goals = LOWER + (rollout.action + 1) / 2 * (UPPER - LOWER)
    expected = np.clip(goals, q - 0.5, q + 0.5)
    assert 0.1 < (expected != goals).mean() < 1.0
    np.testing.assert_allclose(rollout.target, expected, atol=1e-5)
    np.testing.assert_allclose(rollout.observation[:, 13:25], q, atol=1e-6)
    assert np.abs(rollout.torque).max() == pytest.approx(44.4, rel=1e-4)


def test_it_is_measured_and_recorded(rollout, env, tmp_path):
    gait = measure_gait(rollout, env.quadruped)
    assert gait.duration == pytest.approx(STEPS / 240)
    assert np.max(gait.torque_peak) == pytest.approx(1.0, rel=1e-4)  # of 44.4 Nm
    path = tmp_path / "episode.mcap"
    write_mcap(path, add_foot_forces(rollout, env), env.quadruped, {})
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        messages = [
            message.decoded_message for message in reader.iter_decoded_messages(["/observation"])
        ]
    assert len(messages) == STEPS
    assert messages[7].world_position_z == pytest.approx(rollout.qpos[7, 2])
    assert messages[7].world_orientation_w == pytest.approx(rollout.qpos[7, 3])


def test_noise_for_every_number_that_is_seen(env):
    scales = env.sensors.noise_scale.astype(float).round(6)
    by_name = dict(zip(env.sensors.names, scales, strict=True))
    assert by_name["world_position_x"] == 0.05
    assert by_name["world_orientation_w"] == 0.025
    assert by_name["world_velocity_y"] == 0.1
    assert by_name["world_angular_velocity_z"] == 0.2
    joints = env.quadruped.joints
    assert {by_name[f"joint_pos_{joint}"] for joint in joints} == {0.01}
    assert {by_name[f"joint_vel_{joint}"] for joint in joints} == {1.5}
