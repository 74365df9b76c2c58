"""The control step of each engine against physics steps in MuJoCo C, taken one by one."""

import copy

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
UNCHANGED = RobotRandomization(
    1.0, 0.0, np.zeros(3), np.ones(12), *(1.0 for _ in RobotRandomization._fields[4:])
)


def check_step(outcome: tuple, expected: ControlStep) -> None:
    """Assert that a step is MuJoCo's, within single precision, and that some geoms touched."""
    (qpos, qvel), (torque, energy) = outcome
    assert expected.touching
    np.testing.assert_allclose(qpos, expected.qpos, atol=1e-4)
    np.testing.assert_allclose(qvel, expected.qvel, atol=2e-2)
    np.testing.assert_allclose(torque, expected.torque, atol=2e-2)
    np.testing.assert_allclose(energy, expected.energy, rtol=1e-3, atol=1e-5)


def make_converged(quadruped, contacts: str = "feet") -> mujoco.MjModel:
    return quadruped.make_training_model(STEPPING.dt, 100, 50, contacts)


def make_model(quadruped, engine: str, contacts: str = "feet") -> mujoco.MjModel:
    """Return the MuJoCo model that an engine steps."""
    if engine == "mujoco":
        return make_converged(quadruped, contacts)
    return quadruped.make_training_model(
        STEPPING.dt, STEPPING.iterations, STEPPING.line_search, contacts
    )


def to_state(qpos, qvel) -> PhysicsState:
    return PhysicsState(*(jnp.asarray(x, jnp.float32) for x in (qpos, qvel)))


def run_step(engine: str, quadruped, model, motor, qpos, qvel, target) -> tuple:
    """Return the outcome of a jitted control step."""
    constants = ENGINES[engine].make_model(model, quadruped, motor)
    step = jax.jit(lambda state: ENGINES[engine].step(constants, STEPPING, state, target))
    return step(to_state(qpos, qvel))


def make_states(quadruped) -> tuple[np.ndarray, np.ndarray]:
    """Return qpos and qvel of robots that slide and drop onto their feet."""
    rng = np.random.default_rng(1)
    qpos = np.tile(quadruped.home, (ROBOTS, 1))
    qpos[:, 2] -= 0.003
    qpos[:, 7:] += rng.uniform(-0.02, 0.02, (ROBOTS, 12))
    qvel = rng.uniform(-1, 1, (ROBOTS, 18))
    qvel[:, 0] += 1.5
    return qpos, qvel


@pytest.mark.parametrize(
    ("engine", "contacts"),
    [("fast", "feet"), ("mjx", "feet"), ("mjx", "body"), ("mujoco", "feet"), ("mujoco", "body")],
)
def test_a_control_step_is_its_physics_steps_one_by_one(quadruped, engine, contacts):
    """Compare with MuJoCo C, which carries all from step to step; a control step carries little."""
    model = make_model(quadruped, engine, contacts)
    motor = make_motor(model, quadruped, MotorConfig())
    target = quadruped.home[7:] - 0.05
    qpos, qvel = quadruped.home.copy(), np.random.default_rng(1).uniform(-1, 1, 18)
    qpos[7:] += 0.1
    spheres = [quadruped.feet]
    if contacts == "body":  # on its belly, its front knees, and its hind feet
        qpos[2] = 0.055
        qpos[7:] = np.repeat([[0.0, -1.43, -2.7], [0.0, 2.5, -2.75]], 2, axis=0).flat
        spheres += [[f"{kind}_{leg}" for leg in quadruped.legs] for kind in ("knee", "corner")]
    targets = [target] * STEPPING.substeps
    expected = step_control(make_converged(quadruped, contacts), motor, qpos, qvel, targets)
    assert all(expected.touching & {model.geom(name).id for name in kind} for kind in spheres)
    check_step(run_step(engine, quadruped, model, motor, qpos, qvel, target), expected)


@pytest.mark.parametrize("engine", ENGINES)
def test_energy_is_the_kinetic_energy_that_motors_give_a_robot_at_rest(quadruped, engine):
    """Check a robot that floats without gravity: nothing else works on it."""
    model = make_model(quadruped, engine)
    motor = make_motor(model, quadruped, MotorConfig(joint_friction=False, speed_limit=False))
    model.opt.gravity[:] = 0
    model.dof_damping[6:] = 0
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home + np.eye(19)[2]
    target = data.qpos[7:] + np.tile([2.0, 2.0, -2.0], 4)  # so far that no motor brakes
    outcome = run_step(engine, quadruped, model, motor, data.qpos, data.qvel, target)
    (qpos, qvel), effort = outcome
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    kinetic = 0.5 * np.asarray(qvel) @ mass @ qvel
    assert kinetic > 5.0
    np.testing.assert_allclose(effort.energy, kinetic, rtol=0.02)


def test_stiff_joint_damping_is_implicit_as_in_mujoco(quadruped):
    """Check a damping of several times what an explicit step of 4 ms withstands."""
    engine = "fast"  # MJX's solver does not converge from so great accelerations
    model, converged = make_model(quadruped, engine), make_converged(quadruped)
    model.dof_damping[6:] = converged.dof_damping[6:] = 20.0
    motor = make_motor(model, quadruped, MotorConfig())
    qpos, qvel = quadruped.home.copy(), np.random.default_rng(1).uniform(-0.1, 0.1, 18)
    target = quadruped.home[7:] - 0.1
    expected = step_control(converged, motor, qpos, qvel, [target] * STEPPING.substeps)
    check_step(run_step(engine, quadruped, model, motor, qpos, qvel, target), expected)


MOVES = {"ahead": (1, 0, 0), "diagonal": (0.7, 0.7, 0), "sideways": (0, 1, 0), "spin": (0, 0, 3)}


@pytest.mark.parametrize(("engine", "tolerance"), [("fast", 0.03), ("mjx", 0.05)])
def test_robots_slide_on_slippery_floors_as_far_as_in_mujoco(quadruped, engine, tolerance):
    """Compare training's own solver settings with a solver that has converged."""
    dt = PHYSICS["physics_dt"]
    iterations, line_search = PHYSICS["solver_iterations"], PHYSICS["line_search_iterations"]
    stepping = Stepping(dt, 50, iterations, line_search)
    model = quadruped.make_training_model(dt, iterations, line_search)
    motor = make_motor(model, quadruped, MotorConfig())
    target = quadruped.home[7:]
    constants = ENGINES[engine].make_model(model, quadruped, motor)
    floors = [(mu, move) for mu in (0.1, 0.2, 0.4, 1.25) for move in MOVES.values()]

    def slide(friction, qvel):
        randomization = UNCHANGED._replace(friction=friction)
        slippery = ENGINES[engine].apply_randomization(constants, randomization)
        start = PhysicsState(jnp.asarray(quadruped.home, jnp.float32), qvel)
        return ENGINES[engine].step(slippery, stepping, start, target)[0].qvel

    starts = np.zeros((len(floors), 18), np.float32)
    starts[:, [0, 1, 5]] = [move for _, move in floors]
    frictions = np.array([mu for mu, _ in floors], np.float32)
    ends = np.asarray(jax.jit(jax.vmap(slide))(frictions, starts))
    converged = make_converged(quadruped)
    for friction, start, end in zip(frictions, starts, ends, strict=True):
        converged.geom_friction[:, 0] = friction
        targets = [target] * stepping.substeps
        expected = step_control(converged, motor, quadruped.home, start, targets)
        assert expected.touching
        slowdown = np.linalg.norm((start - expected.qvel)[[0, 1, 5]])
        error = np.linalg.norm((end - expected.qvel)[[0, 1, 5]])
        assert error < tolerance * slowdown, (friction, start[[0, 1, 5]], error, slowdown)


def make_different_robots(quadruped, base: mujoco.MjModel) -> list[tuple[mujoco.MjModel, Motor]]:
    """Return robots and motors of which no two share a mass, friction, gain or limit."""
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


@pytest.mark.parametrize("engine", ENGINES)
def test_each_robot_of_a_batch_may_have_constants_and_targets_of_its_own(quadruped, engine):
    base = make_model(quadruped, engine)
    robots = make_different_robots(quadruped, base)
    if engine == "mujoco":  # which has models of their own by `apply_randomization` alone
        robots = [(base, motor) for _, motor in robots]
    make = ENGINES[engine].make_model
    leaves, assemble = stack_models([make(model, quadruped, motor) for model, motor in robots])
    assert len(leaves) > (5 if engine == "mujoco" else 15)

    def step(leaves, physics, target):
        return ENGINES[engine].step(assemble(leaves), STEPPING, physics, target)

    qpos, qvel = make_states(quadruped)
    offsets = np.random.default_rng(3).uniform(-0.2, 0.2, (ROBOTS, STEPPING.substeps, 12))
    targets = quadruped.home[7:] + offsets  # one for each physics step
    outcome = jax.device_get(jax.jit(jax.vmap(step))(leaves, to_state(qpos, qvel), targets))
    for i, (model, motor) in enumerate(robots):
        model.opt.iterations, model.opt.ls_iterations = 100, 50
        expected = step_control(model, motor, qpos[i], qvel[i], targets[i])
        check_step(jax.tree.map(lambda x, i=i: x[i], outcome), expected)


def test_mujoco_randomizes_the_full_model_and_the_motors_of_each_robot(quadruped):
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
    qpos, qvel = (x[0] for x in make_states(quadruped))
    target = quadruped.home[7:] + 0.2

    def step(randomization):
        robot = mujoco_c.apply_randomization(constants, randomization)
        return mujoco_c.step(robot, stepping, to_state(qpos, qvel), target)[0]

    after = jax.jit(jax.vmap(step))(rows)
    for k in range(3):
        row = jax.tree.map(lambda x, k=k: np.asarray(x[k], float), rows)
        robot = copy.copy(model)
        robot.geom_friction[:, 0] = row.friction
        robot.body_mass[1] += row.trunk_mass
        robot.body_ipos[1] += row.trunk_center
        for joint, factor in zip(quadruped.joints, row.link_mass, strict=True):
            body = robot.jnt_bodyid[robot.joint(joint).id]
            robot.body_mass[body] *= factor
            robot.body_inertia[body] *= factor
        robot.dof_armature[6:] *= row.armature
        robot.dof_damping[6:] *= row.damping
        mujoco.mj_setConst(robot, mujoco.MjData(robot))
        randomized = motor._replace(
            kp=row.kp * motor.kp,
            kd=row.kd * motor.kd,
            strength=row.strength,
            friction=row.joint_friction * motor.friction,
        )
        expected = step_control(robot, randomized, qpos, qvel, [target] * 3)
        assert expected.touching
        np.testing.assert_allclose(after.qpos[k], expected.qpos, atol=1e-5)
        np.testing.assert_allclose(after.qvel[k], expected.qvel, atol=2e-3)
    assert np.ptp(after.qvel, axis=0).max() > 0.1


@pytest.mark.parametrize("devices", [1, 2])
def test_large_batches_of_mujoco_pass_through_a_compiled_loop(quadruped, devices):
    """Check arguments of more than 100 kB: JAX's own callback waited for itself forever."""
    model, target = make_converged(quadruped), quadruped.home[7:]
    motor = make_motor(model, quadruped, MotorConfig())
    constants = mujoco_c.make_model(model, quadruped, motor)
    batch = 1600
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:devices]), ("robots",))
    split = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("robots"))
    home = quadruped.home.copy()
    home[2] += 0.05  # whether feet just touch the floor is beyond single precision
    robots = jax.tree.map(lambda x: jnp.tile(x, (batch, 1)), to_state(home, np.zeros(18)))
    once = Stepping(STEPPING.dt, 1, STEPPING.iterations, STEPPING.line_search)
    step = jax.vmap(lambda state: mujoco_c.step(constants, once, state, target)[0])
    run = jax.jit(lambda x: jax.lax.scan(lambda x, _: (step(x), None), x, None, length=5)[0])
    qpos = np.asarray(run(jax.device_put(robots, split)).qpos)
    assert qpos.shape == (batch, 19)
    np.testing.assert_array_equal(qpos, np.tile(qpos[:1], (batch, 1)))
    expected = step_control(model, motor, home, np.zeros(18), [target] * 5)
    np.testing.assert_allclose(qpos[0], expected.qpos, atol=1e-4)


@pytest.mark.parametrize(
    ("dt", "substeps", "expected"), [(0.002, 10, 0.002), (0.003, 7, 0.02 / 7), (0.1, 1, 0.02)]
)
def test_a_control_step_is_cut_into_whole_physics_steps(dt, substeps, expected):
    stepping = STEPPING.replace_dt(dt)
    assert (stepping.substeps, stepping.dt) == (substeps, pytest.approx(expected))
    assert stepping.control_dt == pytest.approx(0.02)
