"""The control step of each engine against physics steps in MuJoCo C, taken here one by one."""

import copy
import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from quadwalk.physics import mujoco_c
from quadwalk.physics.engines import ENGINES
from quadwalk.physics.model import RobotRandomization
from quadwalk.physics.motor import Motor, MotorConfig, PhysicsState, Stepping, make_motor
from quadwalk.settings.environment import PHYSICS
from tests.physics.reference import ControlStep, stack_models, step_control

STEPPING = Stepping(0.004, 5, 8, 10)  # solved to the end
ROBOTS = 6


def check(found: tuple, expected: ControlStep) -> None:
    """Within single precision."""
    (qpos, qvel), (torque, energy) = found
    np.testing.assert_allclose(qpos, expected.qpos, atol=1e-4)
    np.testing.assert_allclose(qvel, expected.qvel, atol=2e-2)
    np.testing.assert_allclose(torque, expected.torque, atol=2e-2)
    np.testing.assert_allclose(energy, expected.energy, rtol=1e-3, atol=1e-5)


def converged(quadruped, contacts: str = "feet") -> mujoco.MjModel:
    return quadruped.make_training_model(STEPPING.dt, 100, 50, contacts)


@functools.cache
def model_for(quadruped, engine: str, contacts: str = "feet") -> mujoco.MjModel:
    if engine == "mujoco":
        return converged(quadruped, contacts)
    return quadruped.make_training_model(
        STEPPING.dt, STEPPING.iterations, STEPPING.line_search, contacts
    )


def states(quadruped) -> tuple[np.ndarray, np.ndarray]:
    """qpos and qvel of robots that slide and drop onto their feet."""
    rng = np.random.default_rng(1)
    qpos = np.tile(quadruped.home, (ROBOTS, 1))
    qpos[:, 2] -= 0.003
    qpos[:, 7:] += rng.uniform(-0.02, 0.02, (ROBOTS, 12))
    qvel = rng.uniform(-1, 1, (ROBOTS, 18))
    qvel[:, 0] += 1.5
    return qpos, qvel


def physics_of(qpos, qvel) -> PhysicsState:
    return PhysicsState(*(jnp.asarray(x, jnp.float32) for x in (qpos, qvel)))


@pytest.mark.parametrize(
    ("engine", "contacts"),
    [("fast", "feet"), ("mjx", "feet"), ("mjx", "body"), ("mujoco", "feet"), ("mujoco", "body")],
)
def test_a_control_step_is_its_physics_steps_one_by_one(quadruped, engine, contacts):
    """It carries little from step to step; MuJoCo C, which carries all, must agree."""
    model = model_for(quadruped, engine, contacts)
    motor = make_motor(model, quadruped, MotorConfig())
    target = quadruped.home[7:] - 0.05
    qpos, qvel = quadruped.home.copy(), np.random.default_rng(1).uniform(-1, 1, 18)
    qpos[7:] += 0.1
    spheres = [quadruped.feet]
    if contacts == "body":  # on its belly, its front knees, and its hind feet
        qpos[2] = 0.055
        qpos[7:] = np.repeat([[0.0, -1.43, -2.7], [0.0, 2.5, -2.75]], 2, axis=0).flat
        spheres += [[f"{kind}_{leg}" for leg in quadruped.legs] for kind in ("knee", "corner")]
    constants = ENGINES[engine].make_model(model, quadruped, motor)
    step = jax.jit(lambda p: ENGINES[engine].step(constants, STEPPING, p, target))
    expected = step_control(
        converged(quadruped, contacts), motor, qpos, qvel, [target] * STEPPING.substeps
    )
    assert all(expected.touching & {model.geom(name).id for name in kind} for kind in spheres)
    check(step(physics_of(qpos, qvel)), expected)


@pytest.mark.parametrize("engine", ENGINES)
def test_energy_is_the_kinetic_energy_that_motors_give_a_robot_at_rest(quadruped, engine):
    """It floats without gravity, and nothing else works on it."""
    model = copy.copy(model_for(quadruped, engine))
    motor = make_motor(model, quadruped, MotorConfig(joint_friction=False, speed_limit=False))
    model.opt.gravity[:] = 0
    model.dof_damping[6:] = 0
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home + np.eye(19)[2]
    constants = ENGINES[engine].make_model(model, quadruped, motor)
    target = data.qpos[7:] + np.tile([2.0, 2.0, -2.0], 4)  # so far that no motor brakes
    physics = physics_of(data.qpos, data.qvel)
    (qpos, qvel), effort = jax.jit(lambda p: ENGINES[engine].step(constants, STEPPING, p, target))(
        physics
    )
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    kinetic = 0.5 * np.asarray(qvel) @ mass @ qvel
    assert kinetic > 5.0
    np.testing.assert_allclose(effort.energy, kinetic, rtol=0.02)


def test_stiff_joint_damping_is_implicit_as_in_mujoco(quadruped):
    """Several times what an explicit step of 4 ms bears."""
    engine = "fast"  # MJX's solver does not converge from so great accelerations
    model = copy.copy(model_for(quadruped, engine))
    model.dof_damping[6:] = 20.0
    motor = make_motor(model, quadruped, MotorConfig())
    qpos, qvel = quadruped.home.copy(), np.random.default_rng(1).uniform(-0.1, 0.1, 18)
    target = quadruped.home[7:] - 0.1
    constants = ENGINES[engine].make_model(model, quadruped, motor)
    found = jax.jit(lambda p: ENGINES[engine].step(constants, STEPPING, p, target))(
        physics_of(qpos, qvel)
    )
    solved = copy.copy(model)
    solved.opt.iterations, solved.opt.ls_iterations = 100, 50
    expected = step_control(solved, motor, qpos, qvel, [target] * STEPPING.substeps)
    assert expected.touching
    check(found, expected)


MOVES = {"ahead": (1, 0, 0), "diagonal": (0.7, 0.7, 0), "sideways": (0, 1, 0), "spin": (0, 0, 3)}


@pytest.mark.parametrize(("engine", "tolerance"), [("fast", 0.03), ("mjx", 0.05)])
def test_robots_slide_on_slippery_floors_as_far_as_in_mujoco(quadruped, engine, tolerance):
    """With training's own solver settings, against a solver that has converged."""
    dt, settings = PHYSICS["physics_dt"], (
        PHYSICS["solver_iterations"], PHYSICS["line_search_iterations"],
    )  # fmt: skip
    stepping = Stepping(dt, 50, *settings)
    model = quadruped.make_training_model(dt, *settings)
    motor = make_motor(model, quadruped, MotorConfig())
    target = quadruped.home[7:]
    constants = ENGINES[engine].make_model(model, quadruped, motor)
    usual = RobotRandomization(
        1.0, 0.0, np.zeros(3), np.ones(12), *(1.0 for _ in RobotRandomization._fields[4:])
    )
    floors = [(mu, move) for mu in (0.1, 0.2, 0.4, 1.25) for move in MOVES.values()]

    def slide(friction, qvel):
        slippery = ENGINES[engine].apply_randomization(constants, usual._replace(friction=friction))
        start = PhysicsState(jnp.asarray(quadruped.home, jnp.float32), qvel)
        return ENGINES[engine].step(slippery, stepping, start, target)[0]

    starts = np.zeros((len(floors), 18), np.float32)
    starts[:, [0, 1, 5]] = [move for _, move in floors]
    frictions = np.array([mu for mu, _ in floors], np.float32)
    found = jax.jit(jax.vmap(slide))(frictions, starts)
    for k, (friction, _) in enumerate(floors):
        reference_model = converged(quadruped)
        reference_model.geom_friction[:, 0] = friction
        expected = step_control(
            reference_model, motor, quadruped.home, starts[k], [target] * stepping.substeps
        )
        assert expected.touching
        lost = np.linalg.norm((starts[k] - expected.qvel)[[0, 1, 5]])
        error = np.linalg.norm((np.asarray(found.qvel[k]) - expected.qvel)[[0, 1, 5]])
        assert error < tolerance * lost, (friction, starts[k, [0, 1, 5]], error, lost)


def varied(quadruped, base: mujoco.MjModel) -> list[tuple[mujoco.MjModel, Motor]]:
    """Robots and motors of which no two have a mass, friction, gain or limit in common."""
    rng = np.random.default_rng(2)
    plain = make_motor(base, quadruped, MotorConfig())
    robots = []
    for _ in range(ROBOTS):
        model = copy.copy(base)
        model.body_mass[:] *= rng.uniform(0.7, 1.4, model.nbody)
        model.body_inertia[:] *= rng.uniform(0.7, 1.4, (model.nbody, 1))
        model.body_ipos[1] += rng.uniform(-0.03, 0.03, 3)
        model.dof_armature[6:] += rng.uniform(0.0, 0.05, 12)
        model.dof_damping[6:] = rng.uniform(0.0, 0.5, model.dof_damping[6:].shape)
        model.geom_friction[:, 0] = rng.uniform(0.3, 1.2)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        motor = Motor(*(value * rng.uniform(0.5, 1.3, 12) for value in plain))
        robots.append((model, motor))
    return robots


def different_targets(quadruped) -> np.ndarray:
    """(robots, substeps, 12) rad."""
    rng = np.random.default_rng(3)
    offsets = rng.uniform(-0.2, 0.2, (ROBOTS, STEPPING.substeps, 12))
    return quadruped.home[7:] + offsets


@pytest.mark.parametrize("engine", ENGINES)
def test_each_robot_of_a_batch_may_have_constants_of_its_own(quadruped, engine):
    base = model_for(quadruped, engine)
    robots = varied(quadruped, base)
    if engine == "mujoco":  # which has models of their own by `apply_randomization` alone
        robots = [(base, motor) for _, motor in robots]
    make = ENGINES[engine].make_model
    leaves, assemble = stack_models([make(model, quadruped, motor) for model, motor in robots])
    assert len(leaves) > (5 if engine == "mujoco" else 15)

    def step(leaves, physics, target):
        return ENGINES[engine].step(assemble(leaves), STEPPING, physics, target)

    qpos, qvel = states(quadruped)
    targets = different_targets(quadruped)
    found = jax.jit(jax.vmap(step))(leaves, physics_of(qpos, qvel), targets)
    for i, (model, motor) in enumerate(robots):
        model.opt.iterations, model.opt.ls_iterations = 100, 50
        expected = step_control(model, motor, qpos[i], qvel[i], targets[i])
        assert expected.touching
        check(jax.tree.map(lambda x, i=i: x[i], found), expected)


def test_mujoco_varies_the_full_model_and_the_motors_of_each_robot(quadruped):
    stepping = Stepping(mujoco_c.TIMESTEP, 3, 8, 10)
    model = quadruped.make_full_model(stepping.dt)
    motor = make_motor(model, quadruped, MotorConfig())
    constants = mujoco_c.make_model(model, quadruped, motor)
    rng = np.random.default_rng(0)
    rows = RobotRandomization(
        friction=np.array([0.3, 0.8, 1.2]), trunk_mass=np.array([-1.0, 0.0, 5.0]),
        trunk_center=rng.uniform(-0.05, 0.05, (3, 3)), link_mass=rng.uniform(0.8, 1.2, (3, 12)),
        strength=np.array([0.7, 1.0, 1.1]), kp=np.array([0.8, 1.0, 1.2]),
        kd=np.array([1.2, 1.0, 0.8]), joint_friction=np.array([0.5, 1.0, 2.0]),
        damping=np.array([0.5, 1.0, 3.0]), armature=np.array([0.8, 1.0, 1.5]),
    )  # fmt: skip
    rows = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), rows)
    qpos, qvel = (x[0] for x in states(quadruped))
    target = quadruped.home[7:] + 0.2

    def step(variation):
        own = mujoco_c.apply_randomization(constants, variation)
        return mujoco_c.step(own, stepping, physics_of(qpos, qvel), target)[0]

    found = jax.jit(jax.vmap(step))(rows)
    for k in range(3):
        row = jax.tree.map(lambda x, k=k: np.asarray(x[k], float), rows)
        own = copy.copy(model)
        own.geom_friction[:, 0] = row.friction
        own.body_mass[1] += row.trunk_mass
        own.body_ipos[1] += row.trunk_center
        for joint, factor in zip(quadruped.joints, row.link_mass, strict=True):
            body = own.jnt_bodyid[own.joint(joint).id]
            own.body_mass[body] *= factor
            own.body_inertia[body] *= factor
        own.dof_armature[6:] *= row.armature
        own.dof_damping[6:] *= row.damping
        mujoco.mj_setConst(own, mujoco.MjData(own))
        changed = motor._replace(
            kp=row.kp * motor.kp,
            kd=row.kd * motor.kd,
            strength=row.strength,
            friction=row.joint_friction * motor.friction,
        )
        expected = step_control(own, changed, qpos, qvel, [target] * 3)
        assert expected.touching
        np.testing.assert_allclose(found.qpos[k], expected.qpos, atol=1e-5)
        np.testing.assert_allclose(found.qvel[k], expected.qvel, atol=2e-3)
    assert np.ptp(found.qvel, axis=0).max() > 0.1


@pytest.mark.parametrize("devices", [1, 2])
def test_large_batches_of_mujoco_pass_through_a_compiled_loop(quadruped, devices):
    """Arguments of more than 100 kB made JAX's own callback wait for itself for ever."""
    base, target = converged(quadruped), quadruped.home[7:]
    motor = make_motor(base, quadruped, MotorConfig())
    engine = ENGINES["mujoco"]
    model = engine.make_model(base, quadruped, motor)
    batch = 1600
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:devices]), ("robots",))
    split = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("robots"))
    home = quadruped.home.copy()
    home[2] += 0.05  # whether feet just touch the floor is beyond single precision
    one = physics_of(home, np.zeros(18))
    start = jax.device_put(jax.tree.map(lambda x: jnp.tile(x, (batch, 1)), one), split)
    once = Stepping(STEPPING.dt, 1, STEPPING.iterations, STEPPING.line_search)

    @jax.jit
    def run(physics):
        def step(physics, _):
            return jax.vmap(lambda p: engine.step(model, once, p, target)[0])(physics), None

        return jax.lax.scan(step, physics, None, length=5)[0]

    qpos = np.asarray(run(start).qpos)
    assert qpos.shape == (batch, 19)
    np.testing.assert_array_equal(qpos, np.tile(qpos[:1], (batch, 1)))
    expected = step_control(base, motor, home, np.zeros(18), [target] * 5)
    np.testing.assert_allclose(qpos[0], expected.qpos, atol=1e-4)


@pytest.mark.parametrize(
    ("dt", "substeps", "expected"), [(0.002, 10, 0.002), (0.003, 7, 0.02 / 7), (0.1, 1, 0.02)]
)
def test_a_control_step_is_cut_into_whole_physics_steps(dt, substeps, expected):
    found = STEPPING.replace_dt(dt)
    assert (found.substeps, found.dt) == (substeps, pytest.approx(expected))
    assert found.control_dt == pytest.approx(0.02)
