"""Episodes of a sweep against MuJoCo C, which is told what the perturbation should come to."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from quadwalk.evaluate.sweep import varied_quadruped
from quadwalk.physics.batching import stack_models
from quadwalk.task import conditions
from quadwalk.task.conditions import first_conditions, sensed, side_of_push, targets_needed
from quadwalk.task.env import QuadrupedEnv
from quadwalk.tasks import run

STEPS, PERIOD = 12, 6  # control steps, and those between pushes
PUSH = 0.8  # m/s
ITERATIONS = 10  # of the contact solver

# name: friction, added mass, strength, delay, push
CASES = {
    "none": (None, 0.0, 1.0, 0, 0.0),
    "friction": (0.2, 0.0, 1.0, 0, 0.0),
    "mass": (None, 5.0, 1.0, 0, 0.0),
    "strength": (None, 0.0, 0.7, 0, 0.0),
    "delay within a control step": (None, 0.0, 1.0, 3, 0.0),
    "delay beyond a control step": (None, 0.0, 1.0, 7, 0.0),
    "push": (None, 0.0, 1.0, 0, PUSH),
    "all": (0.2, 5.0, 0.7, 7, PUSH),
}


@pytest.fixture(scope="module", params=["mjx", "fast"])
def env(quadruped, request) -> QuadrupedEnv:
    # With a solver that converges the engines agree; training cuts it short.
    config = dataclasses.replace(
        run.TASK.env, solver_iterations=ITERATIONS, line_search_iterations=ITERATIONS
    )
    return QuadrupedEnv(quadruped, config, request.param)


@pytest.fixture(scope="module")
def recorded(env, swaying):
    """Of each case: qpos and qvel before and after each control step, and the actions."""
    friction, mass, strength, delay, push = zip(*CASES.values(), strict=True)
    models = []
    for k, changes in enumerate(zip(friction, mass, strict=True)):
        model = env.model_of(varied_quadruped(env.quadruped, *changes))
        motor = model.motor._replace(strength=np.full(12, strength[k]))
        models.append(model._replace(motor=motor))
    leaves, assemble = stack_models(models)
    kept = targets_needed(max(delay), env.config.substeps)

    def episode(leaves, delay, push, state, key):
        model = assemble(leaves)
        home = jnp.asarray(env.robot.home_joints, jnp.float32)
        suffered = first_conditions(home, delay, push, jnp.zeros(()), key, kept)

        def one_step(state, _):
            after = env.step_with(model, state, swaying(state.obs))
            carried = after.pipeline_state
            return after, (carried.qpos, carried.qvel, carried.last_action)

        first = env.with_conditions(state, suffered)
        return jax.lax.scan(one_step, first, None, length=STEPS)[1]

    state = jax.jit(env.reset)(jax.random.PRNGKey(3))
    physics = state.pipeline_state.physics
    physics = physics._replace(
        # A little into the floor: where a foot is just on it, rounding decides whether it touches.
        qpos=physics.qpos.at[2].add(-0.002),
        qvel=physics.qvel.at[:2].set(jnp.array([2.0, 0.5])),  # it slides
    )
    state = state.replace(pipeline_state=state.pipeline_state._replace(physics=physics))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conditions, "PUSH_PERIOD", PERIOD * env.config.control_dt)
        batched = jax.jit(jax.vmap(episode, in_axes=(0, 0, 0, None, None)))
        suffered = jnp.array(delay), jnp.array(push, jnp.float32)
        found = batched(leaves, *suffered, state, jax.random.PRNGKey(5))
    qpos, qvel, actions = map(np.asarray, found)
    before = (np.asarray(physics.qpos), np.asarray(physics.qvel))
    return {
        name: (
            np.concatenate([before[0][None], qpos[k]]),
            np.concatenate([before[1][None], qvel[k]]),
            actions[k],
        )
        for k, name in enumerate(CASES)
    }


def replay_step(env, model, strength, delay, case, step, kick) -> np.ndarray:
    """The velocity that MuJoCo C finds after control step `step`, begun as it was in MJX."""
    qpos, qvel, actions = case
    config, robot, dog = env.config, env.robot, env.quadruped
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos[step], qvel[step]
    data.qvel[1] += kick
    kp, kd = 1.4 * robot.weight * robot.home_height, 0.035 * robot.weight * robot.home_height
    reach = np.tile([0.3, 0.9, 0.9], 4)
    for number in range(config.substeps):
        obeyed = (step * config.substeps + number - delay) // config.substeps
        wanted = actions[obeyed] if obeyed >= 0 else np.zeros(12)
        target = np.clip(robot.home_joints + reach * wanted, robot.lower, robot.upper)
        qd = data.qvel[6:].copy()
        torque = kp * (target - data.qpos[7:]) - kd * qd
        line = dog.effort * np.clip(1 - np.sign(torque) * qd / dog.velocity, 0, 1)
        data.ctrl[:] = strength * np.clip(torque, -line, line)
        data.qfrc_applied[6:] = -dog.friction * np.tanh(qd / 0.1)
        mujoco.mj_step(model, data)
    return data.qvel.copy()


def model_of(env, quadruped, friction, mass) -> mujoco.MjModel:
    """Changed after compilation, where the code under test changes what is compiled."""
    model = quadruped.training_model(env.config.physics_dt, ITERATIONS)
    if friction is not None:
        model.geom_friction[:, 0] = friction
    model.body_mass[model.body(quadruped.trunk).id] += mass
    mujoco.mj_setConst(model, mujoco.MjData(model))
    # Only the load's weight has moved: not the inertia, nor where the centre of mass is.
    np.testing.assert_array_equal(model.body_inertia, env.mj_model.body_inertia)
    np.testing.assert_array_equal(model.body_ipos, env.mj_model.body_ipos)
    return model


# m/s and rad/s after one control step: single precision (measured: 7e-5 at most).
TOLERANCE = 1e-3


@pytest.mark.parametrize("name", CASES)
def test_mujoco_agrees_on_each_perturbation(name, recorded, env, quadruped):
    friction, mass, strength, delay, push = CASES[name]
    model = model_of(env, quadruped, friction, mass)
    plain = model_of(env, quadruped, None, 0.0)
    case = recorded[name]
    error, without, sides = [], [], []
    for step in range(STEPS):
        after = case[1][step + 1]
        options = [
            np.abs(replay_step(env, model, strength, delay, case, step, kick) - after).max()
            for kick in ((0.0, push, -push) if push else (0.0,))
        ]
        sides.append(int(np.argmin(options)))
        error.append(min(options))
        without.append(np.abs(replay_step(env, plain, 1.0, 0, case, step, 0.0) - after).max())
    assert max(error) < TOLERANCE
    if push:
        pushed = np.reshape(sides, (-1, PERIOD)) > 0
        assert pushed.sum(axis=1).tolist() == [1] * (STEPS // PERIOD)
    # And each perturbation is more than what the engines differ by.
    assert (max(without) > 100 * TOLERANCE) == (name != "none")


def test_a_varied_model_is_what_mujoco_derives(env, quadruped):
    found = varied_quadruped(quadruped, 0.5, 3.0).training_model(env.config.physics_dt, ITERATIONS)
    expected = model_of(env, quadruped, None, 3.0)
    for name in ("floor", *quadruped.feet):
        assert found.geom(name).friction.tolist() == [0.5, *env.mj_model.geom(name).friction[1:]]
    for field in ("body_mass", "body_subtreemass", "body_inertia", "body_ipos", "body_invweight0"):
        np.testing.assert_allclose(getattr(found, field), getattr(expected, field), rtol=1e-9)
    np.testing.assert_allclose(found.dof_invweight0, expected.dof_invweight0, rtol=1e-9)
    unchanged = quadruped.training_model(env.config.physics_dt, ITERATIONS)
    np.testing.assert_array_equal(unchanged.body_mass, env.mj_model.body_mass)


def test_only_what_differs_between_models_is_batched(env):
    models = [env.model_of(varied_quadruped(env.quadruped, friction)) for friction in (0.3, 0.9)]
    varied, assemble = stack_models(models)
    assert 0 < len(varied) < len(jax.tree.leaves(env.model)) / 2
    for k, model in enumerate(models):
        found = assemble([leaf[k] for leaf in varied])
        for leaf, expected in zip(*map(jax.tree.leaves, (found, model)), strict=True):
            np.testing.assert_array_equal(leaf, expected)


def test_noise_has_its_scale_and_is_new_in_each_step(env):
    names, scale = env.observation_names, env.noise_scale
    home = jnp.asarray(env.robot.home_joints, jnp.float32)

    def draw(seen, level, steps):
        suffered = first_conditions(home, 0, 0.0, level, jax.random.PRNGKey(0), 1)
        return sensed(suffered, seen, scale, steps)

    drawn = jax.jit(jax.vmap(draw, in_axes=(None, None, 0)))
    found = np.asarray(drawn(jnp.zeros(len(names)), 2.0, jnp.arange(4000)))
    np.testing.assert_allclose(found.std(axis=0), 2 * scale, rtol=0.06)
    np.testing.assert_allclose(found.mean(axis=0), 0, atol=0.12 * scale.max())
    by_name = dict(zip(names, scale, strict=True))
    parts = env.config.observation
    assert by_name["velocity_x"] == np.float32(parts["velocity"].noise)
    assert by_name["angular_velocity_z"] == np.float32(parts["angular_velocity"].noise)
    assert by_name["offset"] == np.float32(parts["offset"].noise)
    assert {std for name, std in by_name.items() if name.startswith("last_action")} == {0.0}
    still = drawn(jnp.ones(len(names)), 0.0, jnp.arange(3))
    np.testing.assert_array_equal(still, 1.0)


def test_one_push_in_every_five_seconds():
    sides = jax.vmap(side_of_push, in_axes=(None, 0, None))
    left = 0
    for seed in range(20):
        found = np.asarray(sides(jax.random.PRNGKey(seed), jnp.arange(1000), 0.02))
        assert set(found) <= {-1.0, 0.0, 1.0}
        assert np.abs(found).reshape(4, 250).sum(axis=1).tolist() == [1, 1, 1, 1]
        left += (found > 0).sum()
    assert 25 < left < 55


@pytest.mark.parametrize(("delay", "kept"), [(0, 1), (1, 2), (5, 2), (6, 3), (10, 3)])
def test_as_many_targets_are_kept_as_a_delay_reaches_back(delay, kept):
    assert targets_needed(delay, 5) == kept
