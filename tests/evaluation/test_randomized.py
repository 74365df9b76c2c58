"""Episodes under drawn conditions: what is recorded and measured."""

import dataclasses
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.randomization import to_values
from quadwalk.evaluation import results as measuring
from quadwalk.evaluation import rollout as simulating
from quadwalk.evaluation.gait import measure_gait
from quadwalk.evaluation.mcap.foot_forces import add_foot_forces
from quadwalk.evaluation.mcap.write import write_mcap
from quadwalk.evaluation.metrics import AT_LIMIT, compute_metrics
from quadwalk.evaluation.report.plots import draw_report
from quadwalk.evaluation.rollout import simulate_episodes
from quadwalk.physics.mujoco_c import randomize_model
from quadwalk.settings.environment import NO_RANDOMIZATION
from quadwalk.tasks import sprint
from tests.evaluation.conftest import read_messages, read_records

EPISODES, ADDED = 3, 0.3
RANGES = dataclasses.replace(
    NO_RANDOMIZATION,
    enabled=True,
    trunk_mass=(ADDED, ADDED),
    link_mass=(0.6, 0.8),
    strength=(0.8, 1.0),
    latency=(0.02, 0.02),
    noise=(1.0, 1.0),
)


@pytest.fixture(scope="module")
def env(quadruped) -> QuadrupedEnv:
    task = dataclasses.replace(sprint.TASK.env, episode_seconds=1.0, randomization=RANGES)
    return QuadrupedEnv(quadruped, task)


# A policy that stands with legs that tremble a little.
TREMBLE = jax.tree_util.Partial(lambda w, observed: 0.01 * jnp.tanh(observed @ w), jnp.eye(47, 12))


@pytest.fixture(scope="module")
def rollouts(env):
    return list(simulate_episodes(env, TREMBLE, EPISODES, seed=0))


def test_each_episode_has_what_was_drawn_for_it(env, rollouts):
    values_by_episode = [to_values(rollout.conditions, env.stepping) for rollout in rollouts]
    strengths = {values["strength"] for values in values_by_episode}
    assert len(strengths) == EPISODES
    assert all(0.8 <= strength <= 1.0 for strength in strengths)
    for values in values_by_episode:
        assert values["latency"] == pytest.approx(0.02)
        assert values["trunk_mass"] == pytest.approx(ADDED * env.robot.mass, rel=1e-5)
        assert values["encoder"] == [0.0] * 12
        others = {"enabled", "push_seconds", "margin", "ideal"}
        assert set(vars(env.config.randomization)) - others == set(values)


def test_motors_obey_the_target_of_a_control_step_before(env, rollouts):
    for rollout in rollouts:
        late = np.concatenate([[env.robot.home_joints], rollout.target[:-1]])
        np.testing.assert_allclose(rollout.applied_target, late, atol=1e-6)
        assert np.abs(np.diff(rollout.target, axis=0)).max() > 1e-4


def test_what_is_seen_is_the_truth_and_noise_of_level_1(env, rollouts):
    noisy = env.sensors.noise_scale > 0
    names = np.array(env.sensors.names)
    for rollout in rollouts:
        off = rollout.observation - rollout.truth
        np.testing.assert_allclose(off[:, ~noisy], 0.0, atol=1e-6)
        level = np.std(off[:, noisy] / env.sensors.noise_scale[noisy])
        assert level == pytest.approx(1.0, abs=0.05)
        joints = np.char.startswith(names, "joint_pos_")
        home = rollout.qpos[:-1, 7:] - env.robot.home_joints
        np.testing.assert_allclose(rollout.truth[:, joints], home, atol=1e-6)


@pytest.fixture
def weight(env, rollouts) -> float:
    """Return the weight of the first episode's robot, N, as MuJoCo has it."""
    model = randomize_model(env.quadruped.make_full_model(), rollouts[0].conditions.variation)
    return mujoco.mj_getTotalmass(model) * env.config.gravity


def test_the_floor_carries_what_was_added(env, rollouts, weight):
    rollout = add_foot_forces(rollouts[0], env)
    carried = rollout.foot_force[25:].sum(axis=1).mean()
    # It sways a little, so that the floor now carries more, now less.
    assert carried == pytest.approx(weight, rel=0.05)


def test_a_stronger_motor_pushes_with_more_than_the_models_limit(env, rollouts):
    conditions = rollouts[0].conditions
    applied_target = rollouts[0].applied_target - 3.0  # rad, beyond what any torque reaches

    def compute_forces(strength):
        variation = conditions.variation._replace(strength=np.float32(strength))
        stronger = conditions._replace(variation=variation)
        rollout = dataclasses.replace(
            rollouts[0], conditions=stronger, applied_target=applied_target
        )
        return add_foot_forces(rollout, env).foot_force[-10:]  # it stands by then

    assert np.abs(compute_forces(1.5) - compute_forces(1.0)).max() > 10.0  # N


def test_figures_are_relative_to_the_robot_that_was_drawn(env, rollouts, weight, monkeypatch):
    rollout = rollouts[0]
    limits = env.quadruped.effort * rollout.conditions.variation.strength
    torque = np.zeros_like(rollout.torque)
    torque[:10, 4] = 0.97 * limits[4]
    qpos = rollout.qpos.copy()
    qpos[:, 0] = np.linspace(0.0, 3.0, len(qpos))
    rollout = dataclasses.replace(rollout, torque=torque, qpos=qpos)
    monkeypatch.setattr(measuring, "simulate_episodes", lambda *_: [rollout])
    loaded = SimpleNamespace(env=env, policy=SimpleNamespace(act=None))
    (figures,) = measuring.evaluate_policy(loaded, 1, 0).episodes
    gait = measure_gait(rollout, env.quadruped)
    cost = pytest.approx(rollout.energy.sum() / 3.0 / weight, rel=1e-5)
    assert figures["torque_limit"] == pytest.approx(100.0 * 10 / rollout.steps)
    assert figures["cost_of_transport"] == cost
    assert gait.cost_of_transport == cost
    assert gait.torque_peak.max() == pytest.approx(0.97)
    notes = [axes.get_title(loc="right") for axes in draw_report(rollout, env.quadruped).axes]
    assert any("peak torque 97 %" in note for note in notes)


def test_episodes_in_groups_are_those_of_one_batch(env, rollouts, monkeypatch):
    monkeypatch.setattr(simulating, "GROUP", 2)
    monkeypatch.setattr(measuring, "GROUP", 2)
    monkeypatch.setattr(simulating, "ROOM", 1)
    loaded = SimpleNamespace(env=env, policy=SimpleNamespace(act=TREMBLE))
    reported: list[int] = []
    evaluation = measuring.evaluate_policy(loaded, EPISODES, 0, reported.append, keep=1)
    assert reported == [33, 50]  # of 50 steps: two of three episodes, then all
    assert [episode["episode"] for episode in evaluation.episodes] == [0, 1, 2]
    assert [rollout.episode for rollout in evaluation.rollouts] == [0]
    middle = int(np.argsort([episode["speed"] for episode in evaluation.episodes])[1])
    assert evaluation.typical.episode == middle
    for one, other in (
        (evaluation.rollouts[0], rollouts[0]),
        (evaluation.typical, rollouts[middle]),
    ):
        np.testing.assert_array_equal(one.qpos[0], other.qpos[0])
        np.testing.assert_allclose(one.qpos, other.qpos, atol=1e-4)
        np.testing.assert_array_equal(one.conditions.targets, other.conditions.targets)


def test_power_and_limits_are_those_of_the_motors(env, rollouts):
    rollout = dataclasses.replace(
        rollouts[0],
        energy=np.full(rollouts[0].steps, 2.0),
        torque=np.zeros_like(rollouts[0].torque),
        action=np.cumsum(np.full_like(rollouts[0].action, 0.001), axis=0),
    )
    rollout.energy[7] = 10.0
    effort = np.asarray(env.motor.effort)
    rollout.torque[:10, 4] = -effort[4]
    rollout.torque[10:20, 5] = 0.9 * AT_LIMIT * effort[5]
    figures = compute_metrics(rollout, env.config.reward, env.robot.weight, effort)
    assert figures["peak_power"] == pytest.approx(10.0 / 0.02)
    assert figures["power"] == pytest.approx((2.0 + 8.0 / rollout.steps) / 0.02)
    assert figures["torque_limit"] == pytest.approx(100.0 * 10 / rollout.steps)
    assert figures["action_rate"] == pytest.approx(0.001 / 0.02, rel=1e-4)
    assert measure_gait(rollout, env.quadruped).action_rate == figures["action_rate"]


def test_a_recording_holds_the_truth_and_the_obeyed_targets(env, rollouts, tmp_path):
    rollout, path = add_foot_forces(rollouts[1], env), tmp_path / "episode.mcap"
    values = to_values(rollout.conditions, env.stepping)
    write_mcap(path, rollout, env.quadruped, {"conditions": json.dumps(values)})
    evaluation = read_messages(path)
    for topic in ("/truth", "/joint_applied_target", "/observation", "/joint_cmd"):
        assert len(evaluation[topic]) == rollout.steps
    assert json.loads(read_records(path)[0]["quadwalk"]["conditions"]) == values


def test_the_report_shows_what_was_seen_beside_the_truth(env, rollouts):
    panels = draw_report(rollouts[0], env.quadruped).axes
    truth_panels = [axes for axes in panels if "the truth" in axes.get_title(loc="left")]
    assert len(truth_panels) == 3
    for axes in truth_panels:
        name = axes.get_title(loc="left").partition(":")[0].lower()
        column = [n.lower() for n in env.sensors.names].index(name)
        observed, true = axes.get_lines()
        steps = (observed.get_xdata() / rollouts[0].control_dt).round().astype(int)
        assert len(steps) > 5
        np.testing.assert_array_equal(observed.get_ydata(), rollouts[0].observation[steps, column])
        np.testing.assert_array_equal(true.get_ydata(), rollouts[0].truth[steps, column])
