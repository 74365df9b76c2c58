import dataclasses

import brax.envs.base
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers.training import EvalWrapper, wrap
from scipy.spatial.transform import Rotation

from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UsageError
from quadwalk.physics.motor import Effort
from quadwalk.settings.terms import Reward
from quadwalk.tasks import run, sprint
from tests.physics.reference import place_robot

STILL = jnp.zeros((4, 12))


def physics_of(state):
    return state.pipeline_state.physics


def with_qpos(state, qpos):
    physics = physics_of(state)._replace(qpos=qpos, qvel=jnp.zeros((4, 18)))
    return state.replace(pipeline_state=state.pipeline_state._replace(physics=physics))


def ends(env, state):
    """Return the name of each episode's end."""
    return [env.ends[i] for i in np.asarray(state.info["end"])]


def test_it_is_a_brax_environment(env, reset):
    assert isinstance(env, brax.envs.base.Env)
    assert reset(0).obs.shape == (4, env.observation_size) == (4, 47)
    assert env.action_size == 12
    assert len(set(env.sensors.names)) == 47


def test_the_wrappers_of_brax_run_it(env):
    wrapped = EvalWrapper(wrap(env, episode_length=3))
    first = state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(0), 2))
    start, step = np.asarray(first.obs), jax.jit(wrapped.step)
    for count in (1, 2, 3, 1):
        state = step(state, jnp.full((2, 12), 0.5))
        assert state.info["steps"].tolist() == [count] * 2
        assert state.done.tolist() == [count == 3] * 2
        assert np.array_equal(state.obs, start) == (count == 3)
    evaluated = state.info["eval_metrics"]
    assert evaluated.episode_steps.tolist() == [3, 3]
    assert set(evaluated.episode_metrics) == {*first.metrics}


def test_starts_differ_and_the_same_key_gives_the_same_start(reset):
    a, b, c = (np.asarray(physics_of(reset(seed)).qpos) for seed in (0, 1, 0))
    assert len(np.unique(np.concatenate([a, b]), axis=0)) == 8
    np.testing.assert_array_equal(a, c)


def test_a_start_stands_with_its_lowest_foot_on_the_floor(env, reset):
    for qpos in np.asarray(physics_of(reset(3)).qpos):
        data = place_robot(env.mj_model, qpos)
        feet = [env.mj_model.geom(name) for name in env.quadruped.feet]
        soles = [data.geom_xpos[foot.id, 2] - foot.size[0] for foot in feet]
        assert min(soles) == pytest.approx(0.0, abs=1e-5)
        assert np.linalg.norm(qpos[3:7]) == pytest.approx(1.0, abs=1e-5)


def test_the_observation_is_what_its_names_say(env, reset, step):
    state = step(reset(5), jnp.full((4, 12), 0.25))
    names = env.sensors.names
    qpos, qvel = (np.asarray(x, float)[0] for x in physics_of(state)[:2])
    turn = Rotation.from_quat(qpos[[4, 5, 6, 3]])
    expected = {
        "velocity": turn.inv().apply(qvel[:3]),
        "angular_velocity": qvel[3:6],
        "gravity": turn.inv().apply([0, 0, -1]),
    }
    obs = dict(zip(names, np.asarray(state.obs[0]), strict=True))
    for name, vector in expected.items():
        components = [obs[f"{name}_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose(components, vector, atol=1e-5)
    assert obs["heading"] == pytest.approx(turn.as_euler("ZYX")[0], abs=1e-5)
    assert obs["offset"] == pytest.approx(qpos[1], abs=1e-6)
    for i, joint in enumerate(env.quadruped.joints):
        assert obs[f"joint_pos_{joint}"] == pytest.approx(
            qpos[7 + i] - env.robot.home[7 + i], abs=1e-5
        )
        assert obs[f"joint_vel_{joint}"] == pytest.approx(qvel[6 + i], abs=1e-5)
        assert obs[f"last_action_{joint}"] == 0.25


def test_the_time_limit_truncates_and_is_not_a_fall(env, reset, step):
    state = reset(0)
    for k in range(5):  # 0.1 s of 0.02 s steps
        assert not state.done.any(), k
        state = step(state, STILL)
    assert ends(env, state) == ["time limit"] * 4
    assert state.done.all()
    assert state.info["truncation"].all()
    assert not state.metrics["fell"].any()


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        ("tipped", lambda q: q.at[:, 2].set(1.0).at[:, 3:7].set(jnp.array([0.6, 0.8, 0, 0]))),
        ("low", lambda q: q.at[:, 2].set(0.14).at[:, 8::3].set(1.9).at[:, 9::3].set(-2.7)),
        # Deep knees, trunk still high: thighs laid back, calves ahead and down through the floor.
        ("touched", lambda q: q.at[:, 2].set(0.22).at[:, 8::3].set(0.3).at[:, 9::3].set(-2.6)),
    ],
)
def test_a_fall_ends_the_episode_and_says_why(env, reset, step, reason, change):
    state = reset(0)
    home = jnp.tile(jnp.array([0, 0, 0.375, 1, 0, 0, 0, *[0, 0.8, -1.6] * 4]), (4, 1))
    state = step(with_qpos(state, change(home)), STILL)
    assert ends(env, state) == [reason] * 4
    assert state.metrics["fell"].all()
    assert not state.info["truncation"].any()
    assert (state.reward < -5).all()


def test_a_shin_does_not_touch_because_its_foot_sinks_in(env):
    """Check that a shin stays clear of the floor while its foot sinks in.

    It touches the floor only where the foot has sunk in by more than its radius.
    """
    term = Reward(lambda robot, step: step.lowest[1], scale=1.0)
    env = QuadrupedEnv(env.quadruped, dataclasses.replace(env.config, reward={"seen": term}))
    start = jax.jit(env.reset)(jax.random.PRNGKey(0)).pipeline_state
    none = Effort(jnp.zeros(12), jnp.zeros(()))

    @jax.jit
    def legs(sunk):
        qpos = jnp.asarray(env.robot.home).at[2].add(-sunk)
        after = start._replace(physics=start.physics._replace(qpos=qpos))
        return env.evaluate_step(start, after, none, jnp.ones((), bool)).metrics["reward/seen"]

    radius = float(env.mj_model.geom(env.quadruped.feet[0]).size[0])
    clear = float(legs(0.0))
    assert 0.0 < clear < radius
    assert float(legs(-0.1)) == pytest.approx(clear + 0.1, abs=1e-5)  # in the air
    assert float(legs(0.9 * radius)) == pytest.approx(clear, abs=1e-5)
    assert float(legs(radius + clear + 0.01)) == pytest.approx(-0.01, abs=1e-5)


@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e30])
def test_a_state_that_is_not_finite_ends_its_episode_and_goes_no_further(env, reset, step, poison):
    state = reset(0)
    qpos = physics_of(state).qpos.at[:, :2].add(jnp.array([30.0, -4.0])).at[1, 9].set(poison)
    velocity = physics_of(state).qvel.at[2, 3].set(poison)
    physics = physics_of(state)._replace(qpos=qpos, qvel=velocity)
    state = state.replace(pipeline_state=state.pipeline_state._replace(physics=physics))
    after = step(state, STILL.at[3].set(poison if not np.isfinite(poison) else 0.0))
    broken = [False, True, True, not np.isfinite(poison)]
    assert [end == "nan" for end in ends(env, after)] == broken
    assert np.asarray(after.metrics["nan"]).tolist() == broken
    assert not after.metrics["fell"][np.array(broken)].any()
    for leaf in jax.tree.leaves(after):
        assert np.isfinite(np.asarray(leaf, float)).all()
    # It ends where it was, or at home where that is no place.
    qpos_after, qpos_before = np.asarray(physics_of(after).qpos), np.asarray(qpos)
    np.testing.assert_array_equal(qpos_after[1], env.robot.home.astype(np.float32))
    for row in np.flatnonzero([False, False, *broken[2:]]):
        np.testing.assert_array_equal(qpos_after[row], qpos_before[row])


def test_a_step_leaves_what_it_was_given_alone_and_repeats_itself(reset, step):
    state = reset(7)
    before = jax.device_get(state)
    first, second = step(state, STILL), step(state, STILL)
    for a, b in zip(jax.tree.leaves(before), jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    "bad",
    [{"physics_dt": 0.0}, {"substeps": 0}, {"episode_seconds": 0.0}, {"solver_iterations": 0}],
)
def test_a_setting_out_of_range_is_refused(bad):
    with pytest.raises(UsageError, match=r"expected|or more"):
        dataclasses.replace(sprint.TASK.env, **bad)


def test_the_policy_sees_what_was_seen_before_and_the_critic_the_truth(quadruped):
    world = dataclasses.replace(run.TASK.env.randomization, enabled=False)
    env = QuadrupedEnv(quadruped, dataclasses.replace(run.TASK.env, randomization=world))
    names = (*env.sensors.names, *(f"critic_{name}" for name in env.sensors.critic_names))
    assert len(names) == len(set(names)) == env.observation_size
    assert env.policy_size == 43 + 4 * 42  # all but the heading four times more
    step = jax.jit(env.step)
    state = jax.jit(env.reset)(jax.random.PRNGKey(1))
    observations = []
    for k in range(6):
        observations.append(dict(zip(names, np.asarray(state.obs), strict=True)))
        state = step(state, jnp.full(12, 0.1 * k))
    joint = quadruped.joints[4]
    for name in ("gravity_x", f"joint_vel_{joint}", f"last_action_{joint}"):
        for ago in range(1, 5):
            assert observations[5][f"{name}[-{ago}]"] == observations[5 - ago][name]
    assert observations[0]["gravity_x[-4]"] == observations[0]["gravity_x"]
    assert "heading[-1]" not in names
    assert not {"velocity_x", "height"} & set(names)
    qpos = state.pipeline_state.qpos
    last = dict(zip(names, np.asarray(state.obs), strict=True))
    assert last["critic_height"] == qpos[2]
    touching = [last[f"critic_contacts_{foot}"] for foot in range(4)]
    np.testing.assert_array_equal(touching, np.asarray(state.info["contact"]))
