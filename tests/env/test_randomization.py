"""Domain randomization: its ranges, and its effects against MuJoCo C on a changed model."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from quadwalk.env.actions import delay_targets
from quadwalk.env.env import QuadrupedEnv, sample_push_signs
from quadwalk.env.randomization import count_targets, sample_randomization, widen_range
from quadwalk.env.sensors import add_noise, add_offsets, delay_reading
from quadwalk.env.state import EpisodeRandomization
from quadwalk.physics.model import RobotRandomization
from quadwalk.physics.motor import Motor
from quadwalk.settings.environment import NO_RANDOMIZATION
from quadwalk.tasks import run, sprint
from tests.physics.reference import step_control

STEPS, PERIOD = 12, 6  # control steps, and those between pushes
PUSH = 0.8  # m/s
ITERATIONS = 10  # of the contact solver


class Case(NamedTuple):
    """Differences from the model: numbers added, or factors, as in `EpisodeRandomization`."""

    friction: float | None = None
    mass: float = 0.0
    center: float = 0.0  # m, ahead
    links: float = 1.0
    strength: float = 1.0
    kp: float = 1.0
    kd: float = 1.0
    joint_friction: float = 1.0
    damping: float = 1.0
    armature: float = 1.0
    delay: int = 0
    push: float = 0.0
    encoder: float = 0.0


CASES = {
    "none": Case(),
    "friction": Case(friction=0.2),
    "mass": Case(mass=5.0),
    "center": Case(center=0.05),
    "links": Case(links=1.3),
    "strength": Case(strength=0.7),
    "gains": Case(kp=0.8, kd=1.3),
    "joints": Case(joint_friction=2.0, damping=4.0, armature=3.0),
    "delay within a control step": Case(delay=3),
    "delay beyond a control step": Case(delay=7),
    "encoder": Case(encoder=0.05),
    "push": Case(push=PUSH),
    "all": Case(0.2, 5.0, 0.05, 1.2, 0.7, 0.8, 1.2, 2.0, 3.0, 2.0, 7, PUSH, 0.05),
}


def make_ranged_env(quadruped, **ranges) -> QuadrupedEnv:
    """Return the task `run` with these ranges of its randomization."""
    changed = dataclasses.replace(run.TASK.env.randomization, **ranges)
    config = dataclasses.replace(run.TASK.env, randomization=changed)
    return QuadrupedEnv(quadruped, config, "fast")


def sample_nominal(env: QuadrupedEnv, key: jax.Array) -> EpisodeRandomization:
    """Return conditions in which nothing differs from the model."""
    return sample_randomization(NO_RANDOMIZATION, env.robot, env.stepping, key, env.friction)


@pytest.fixture(scope="module", params=["mjx", "fast"])
def env(quadruped, request) -> QuadrupedEnv:
    # With a solver that converges the engines agree; training cuts it short.
    converging = {"solver_iterations": ITERATIONS, "line_search_iterations": ITERATIONS}
    config = dataclasses.replace(sprint.TASK.env, **converging)
    pushed = dataclasses.replace(config.randomization, push_seconds=PERIOD * config.control_dt)
    return QuadrupedEnv(quadruped, dataclasses.replace(config, randomization=pushed), request.param)


@pytest.fixture(scope="module")
def swaying() -> jax.tree_util.Partial:
    """Return a policy that moves the legs a little by what it observes."""
    weights = 0.03 * jax.random.normal(jax.random.PRNGKey(1), (47, 12))
    return jax.tree_util.Partial(lambda w, observation: jnp.tanh(observation @ w), weights)


@pytest.fixture(scope="module")
def recorded(env, swaying):
    """Return for each case qpos and qvel around each control step, and the actions."""
    rows_kept = count_targets(max(case.delay for case in CASES.values()), env.config.substeps)
    cases = [
        case if case.friction else case._replace(friction=env.friction) for case in CASES.values()
    ]
    rows = Case(*jnp.array(cases, jnp.float32).T)._asdict()

    def episode(row, state, key):
        usual = sample_nominal(env, key)
        variation = usual.variation._replace(
            friction=row["friction"],
            trunk_mass=row["mass"],
            trunk_center=row["center"] * jnp.array([1.0, 0.0, 0.0]),
            link_mass=jnp.full(12, row["links"]),
            **{k: row[k] for k in ("strength", "kp", "kd", "joint_friction", "damping")},
            armature=row["armature"],
        )
        conditions = usual._replace(
            variation=variation,
            delay=row["delay"],
            push=jnp.array([0.0, 1.0]) * row["push"],
            encoder=jnp.full(12, row["encoder"]),
            targets=jnp.tile(usual.targets, (rows_kept, 1)),
        )

        def one_step(state, _):
            after = env.step(state, swaying(state.obs))
            carried = after.pipeline_state
            return after, (carried.qpos, carried.qvel, carried.last_action)

        first = env.start_episode(state, conditions=conditions)
        return jax.lax.scan(one_step, first, None, length=STEPS)[1]

    state = jax.jit(env.reset)(jax.random.PRNGKey(3))
    physics = state.pipeline_state.physics
    physics = physics._replace(
        # A little into the floor: where a foot is just on it, rounding decides whether it touches.
        qpos=physics.qpos.at[2].add(-0.002),
        qvel=physics.qvel.at[:2].set(jnp.array([2.0, 0.5])),  # it slides
    )
    state = state.replace(pipeline_state=state.pipeline_state._replace(physics=physics))
    batched = jax.jit(jax.vmap(episode, in_axes=(0, None, None)))
    actual = batched(rows, state, jax.random.PRNGKey(5))
    qpos, qvel, actions = map(np.asarray, actual)
    return {
        name: (np.r_[physics.qpos[None], qpos[k]], np.r_[physics.qvel[None], qvel[k]], actions[k])
        for k, name in enumerate(CASES)
    }


def replay_step(env, model, case, states, step, side) -> np.ndarray:
    """Return the velocity that MuJoCo C finds after control step `step`, from the same start."""
    qpos, qvel, actions = states
    config, robot, dog = env.config, env.robot, env.quadruped
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, qpos[step, 3:7].astype(float))
    heading = np.arctan2(turn[3], turn[0])
    pushed = qvel[step].copy()
    pushed[:2] += side * case.push * np.array([-np.sin(heading), np.cos(heading)])
    stiff = 1.4 * robot.weight * robot.home_height
    kp, kd = case.kp * stiff, case.kd * 0.025 * stiff
    friction = case.joint_friction * dog.friction
    motor = Motor(kp, kd, case.strength, dog.effort, dog.velocity, friction)
    reach = np.tile([0.3, 0.9, 0.9], 4)
    targets = []
    for number in range(config.substeps):
        applied_target = (step * config.substeps + number - case.delay) // config.substeps
        action = actions[applied_target] if applied_target >= 0 else np.zeros(12)
        targets.append(np.clip(robot.home_joints + reach * action, robot.lower, robot.upper))
    return step_control(model, motor, qpos[step], pushed, targets, case.encoder).qvel


def make_model(env, quadruped, case) -> mujoco.MjModel:
    """Return the compiled model, changed as the case says."""
    model = quadruped.make_training_model(env.config.physics_dt, ITERATIONS)
    if case.friction is not None:
        model.geom_friction[:, 0] = case.friction
    trunk = model.body(quadruped.trunk).id
    model.body_mass[trunk] += case.mass
    model.body_ipos[trunk, 0] += case.center
    for body in range(trunk + 1, model.nbody):
        model.body_mass[body] *= case.links
        model.body_inertia[body] *= case.links
    model.dof_damping[6:] *= case.damping
    model.dof_armature[6:] *= case.armature
    return model


# m/s and rad/s after one control step: single precision (measured: 7e-5 at most).
TOLERANCE = 1e-3


@pytest.mark.parametrize("name", CASES)
def test_mujoco_agrees_on_each_perturbation(name, recorded, env, quadruped):
    case, states = CASES[name], recorded[name]
    model, plain = make_model(env, quadruped, case), make_model(env, quadruped, Case())
    error, without, sides = [], [], []
    for step in range(STEPS):
        after = states[1][step + 1]
        options = [
            np.abs(replay_step(env, model, case, states, step, side) - after).max()
            for side in ((0.0, 1.0, -1.0) if case.push else (0.0,))
        ]
        sides.append(int(np.argmin(options)))
        error.append(min(options))
        usual = replay_step(env, plain, Case(), states, step, 0.0)
        without.append(np.abs(usual - after).max())
    assert max(error) < TOLERANCE
    if case.push:
        pushed = np.reshape(sides, (-1, PERIOD)) > 0
        assert pushed.sum(axis=1).tolist() == [1] * (STEPS // PERIOD)
    # And each perturbation is more than what the engines differ by.
    assert (max(without) > 50 * TOLERANCE) == (name != "none")


def test_noise_has_its_scale_and_is_new_in_each_step(env):
    names, scale = env.sensors.names, env.sensors.noise_scale

    def draw(observation, level, steps):
        conditions = sample_nominal(env, jax.random.PRNGKey(0))._replace(noise=level)
        return add_noise(conditions, observation, scale, steps)

    sampled = jax.jit(jax.vmap(draw, in_axes=(None, None, 0)))
    actual = np.asarray(sampled(jnp.zeros(len(names)), 2.0, jnp.arange(4000)))
    np.testing.assert_allclose(actual.std(axis=0), 2 * scale, rtol=0.06)
    np.testing.assert_allclose(actual.mean(axis=0), 0, atol=0.12 * scale.max())
    by_name = dict(zip(names, scale, strict=True))
    parts = env.config.observation
    assert by_name["velocity_x"] == np.float32(parts["velocity"].noise)
    assert by_name["angular_velocity_z"] == np.float32(parts["angular_velocity"].noise)
    assert by_name["offset"] == np.float32(parts["offset"].noise)
    assert {std for name, std in by_name.items() if name.startswith("last_action")} == {0.0}
    still = sampled(jnp.ones(len(names)), 0.0, jnp.arange(3))
    np.testing.assert_array_equal(still, 1.0)


def test_one_push_in_every_five_seconds(env):
    def side(key, steps):
        return sample_push_signs(sample_nominal(env, key), steps, 250)

    sides = jax.jit(jax.vmap(jax.vmap(side, in_axes=(None, 0)), in_axes=(0, None)))
    actual = np.asarray(sides(jax.random.split(jax.random.PRNGKey(0), 20), jnp.arange(1000)))
    assert set(actual.ravel().tolist()) == {-1.0, 0.0, 1.0}
    assert (np.abs(actual).reshape(20, 4, 250, 2).sum(axis=2) == 1).all()
    assert ((actual > 0).sum(axis=(0, 1)) > 25).all()
    assert ((actual > 0).sum(axis=(0, 1)) < 55).all()


@pytest.mark.parametrize(("delay", "rows_kept"), [(0, 1), (1, 2), (5, 2), (6, 3), (10, 3)])
def test_as_many_targets_are_kept_as_a_delay_reaches_back(delay, rows_kept):
    assert count_targets(delay, 5) == rows_kept


def test_a_delay_between_two_physics_steps_is_one_or_the_other(env):
    changed = {"delay": jnp.float32(2.3), "targets": jnp.zeros((2, 12))}
    late = sample_nominal(env, jax.random.PRNGKey(1))._replace(**changed)
    new = jax.vmap(lambda k: delay_targets(late, jnp.ones(12), 5, k)[1][:, 0])(jnp.arange(4000))
    waited = 5 - np.asarray(new).sum(axis=1)  # physics steps until the new target is obeyed
    assert set(waited) == {2.0, 3.0}
    assert waited.mean() == pytest.approx(2.3, abs=0.03)


def test_a_late_sensor_tells_what_was_on_the_line_between_two_readings():
    frames = jnp.array([[5.0], [4.0], [2.0], [1.0]])
    late = jnp.float32(1.25)
    assert delay_reading(late, frames) == pytest.approx(0.75 * 4.0 + 0.25 * 2.0)
    assert delay_reading(late, frames[1:]) == pytest.approx(0.75 * 2.0 + 0.25 * 1.0)


def test_a_tilted_imu_sees_the_world_turned(env):
    tilt = np.array([0.03, -0.05, 0.0])
    state = jax.jit(env.reset)(jax.random.PRNGKey(2)).pipeline_state
    changed = {"tilt": jnp.asarray(tilt, jnp.float32), "encoder": jnp.full(12, 0.01)}
    conditions = sample_nominal(env, jax.random.PRNGKey(1))._replace(**changed)
    actual = add_offsets(conditions, state.physics)
    turn, orientation, expected = np.zeros(4), np.asarray(state.qpos[3:7], float), np.zeros(4)
    angle = np.linalg.norm(tilt)
    mujoco.mju_axisAngle2Quat(turn, tilt / angle, angle)
    mujoco.mju_mulQuat(expected, orientation, turn)
    np.testing.assert_allclose(actual.qpos[3:7], expected, atol=1e-4)
    back, spin = turn * [1, -1, -1, -1], np.zeros(3)
    mujoco.mju_rotVecQuat(spin, np.asarray(state.qvel[3:6], float), back)
    np.testing.assert_allclose(actual.qvel[3:6], spin, atol=1e-4)
    np.testing.assert_allclose(actual.qpos[7:], state.qpos[7:] + 0.01, atol=1e-6)


@pytest.fixture(scope="module")
def sampled_episodes(quadruped):
    """Return an environment without a margin, and the conditions of 2000 episodes."""
    env = make_ranged_env(quadruped, push=(0.3, 0.5), margin=0.0)
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    return env, jax.jit(jax.vmap(env.reset))(keys).pipeline_state.conditions


def test_every_episode_draws_its_own_within_the_ranges(sampled_episodes):
    env, sampled = sampled_episodes
    names = ("friction", "trunk_mass", "trunk_center", "link_mass", "strength", "kp", "kd")
    actual = {name: getattr(sampled.variation, name) for name in names}
    actual |= {
        "latency": sampled.delay,
        "sensor_latency": sampled.sensor_delay,
        "noise": sampled.noise,
    }
    actual |= {"encoder": sampled.encoder, "imu_tilt": sampled.tilt}
    units = {"trunk_mass": env.robot.mass, "trunk_center": env.robot.home_height}
    units |= {"latency": 1 / 0.004, "sensor_latency": 1 / 0.02}
    for name, values in actual.items():
        low, high = np.multiply(getattr(env.config.randomization, name), units.get(name, 1.0))
        width = high - low
        assert low - 1e-5 <= values.min() < low + 0.05 * width, name
        assert high - 0.05 * width < values.max() <= high + 1e-5, name
        assert np.mean(values) == pytest.approx((low + high) / 2, abs=0.1 * width), name


def test_pushes_go_to_all_sides_alike(sampled_episodes):
    env, push = sampled_episodes[0], np.asarray(sampled_episodes[1].push)
    inner, outer = np.array([0.3, 0.5]) * np.sqrt(9.81 * env.robot.home_height)
    size, angle = np.hypot(*push.T), np.arctan2(push[:, 1], push[:, 0])
    assert inner <= size.min() + 1e-5
    assert size.max() <= outer + 1e-5
    # Of a ring's area, so much is within this circle; 2000 draws tell a share to some 0.03.
    within = np.mean(size < (inner + outer) / 2)
    assert within == pytest.approx((0.4**2 - 0.3**2) / (0.5**2 - 0.3**2), abs=0.04)
    # Signs are drawn at each push: of the angle, a quarter turn.
    assert np.histogram(angle, 5, (0.0, np.pi / 2))[0] == pytest.approx(400, abs=80)


ends = st.floats(-10.0, 10.0)


@given(st.tuples(ends, ends).map(sorted), ends, st.floats(0.0, 1.0))
@example([0.01, 0.03], 0.0, 0.15)
@example([0.3, 0.6], 0.8, 0.15)
def test_training_draws_from_no_less_than_an_evaluation(between, usual, margin):
    (low, high), (inner, outer) = widen_range(between, usual, margin), between
    assert low <= inner <= outer <= high
    shift = max(abs(low - inner), abs(high - outer))
    assert shift <= margin * max(abs(inner - usual), abs(outer - usual)) + 1e-9


def test_a_margin_moves_an_end_away_from_the_models_value_but_not_into_the_range(quadruped):
    changed = {"friction": (0.3, 1.25), "strength": (0.8, 1.1), "latency": (0.01, 0.02)}
    env = make_ranged_env(quadruped, **changed, push=(0.4, 0.5), margin=0.5)

    def draw(key: jax.Array) -> EpisodeRandomization:
        ranges = env.config.randomization
        return sample_randomization(ranges, env.robot, env.stepping, key, friction=1.0)

    sampled = jax.jit(jax.vmap(draw))(jax.random.split(jax.random.PRNGKey(0), 2000))
    froude = np.sqrt(env.robot.gravity * env.robot.home_height)
    expected = {
        (0.0, 1.375): sampled.variation.friction,  # 1 - 1.5 * .7 is below 0, which none can be
        (0.7, 1.15): sampled.variation.strength,
        (0.01, 0.03): sampled.delay * env.stepping.dt,
        (0.4, 0.75): np.linalg.norm(sampled.push, axis=-1) / froude,
    }
    for (low, high), values in expected.items():
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < values.max() <= high + 1e-5
    # Targets are kept for the longest of these delays: of 8 physics steps, in control steps of 5.
    assert sampled.targets.shape[1] == 3


def test_a_share_of_episodes_is_ideal_and_the_others_are_drawn_as_without(quadruped):
    env = QuadrupedEnv(quadruped, run.TASK.env, "fast")
    keys = jax.random.split(jax.random.PRNGKey(0), 1000)

    def sampled(ideal: float) -> EpisodeRandomization:
        ranges = dataclasses.replace(run.TASK.env.randomization, ideal=ideal)
        return jax.vmap(
            lambda key: sample_randomization(ranges, env.robot, env.stepping, key, 0.8)
        )(keys)

    some, none = sampled(0.25), sampled(0.0)
    ideal = np.asarray(some.noise) == 0.0
    assert 0.2 < ideal.mean() < 0.3
    for one, other in zip(jax.tree.leaves(some), jax.tree.leaves(none), strict=True):
        np.testing.assert_array_equal(one[~ideal], other[~ideal])
    actual = jax.tree.map(
        lambda x: np.unique(x[ideal]).tolist(), some._replace(key=None, targets=None)
    )
    factors = {name: [1.0] for name in RobotRandomization._fields}
    expected = factors | {"friction": [pytest.approx(0.8)], "trunk_mass": [0], "trunk_center": [0]}
    assert actual.variation._asdict() == expected
    for name in ("delay", "sensor_delay", "push", "noise", "encoder", "tilt"):
        assert getattr(actual, name) == [0.0]


def test_what_is_off_is_as_the_model(quadruped):
    env = make_ranged_env(quadruped, push=None, friction=None, latency=None)
    sampled = jax.jit(env.reset)(jax.random.PRNGKey(0)).pipeline_state.conditions
    assert sampled.variation.friction == pytest.approx(env.friction)
    assert not np.any(sampled.push)
    assert sampled.delay == 0.0
    env = make_ranged_env(quadruped, enabled=False)
    assert jax.eval_shape(env.reset, jax.random.PRNGKey(0)).pipeline_state.conditions is None
