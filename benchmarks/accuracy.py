"""Compare the engines with MuJoCo C whose solver has converged: trotting, and sliding.

    python benchmarks/accuracy.py

Trotting: from the same 16 starts and with the same joint targets each setting trots for a second.
Printed are the distance between the trunk's positions at the end and in MuJoCo C at 1 ms, the mean
distance between its velocities, and how deep feet sank. Part of the error at 4 ms is the step's,
whatever the solver: the row of MuJoCo C at 4 ms.

Sliding: a robot that stands gets a velocity on a slippery floor. Printed is the speed that it loses
within 0.15 s, relative to MuJoCo C with the same steps of 4 ms. Downhill, the difference to
MuJoCo C counts relative to what is lost on level ground.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from quadwalk.learn.devices import set_up_devices
from quadwalk.physics.engines import ENGINES, EngineName

ROBOTS = 16
SECONDS = 1.0
CONTROL = 0.02  # s, joint targets hold so long
STRIDES = 2.5  # per second


def targets(home: np.ndarray) -> np.ndarray:
    """(steps, 12) rad, joint targets of a trot on the spot: diagonal feet lifted in turn."""
    times = np.arange(0, SECONDS, CONTROL)[:, None]
    lift = np.maximum(np.sin(2 * np.pi * STRIDES * times + np.pi * np.array([0, 1, 1, 0])), 0.0)
    # A thigh forward and a calf folded by twice that lift the foot straight up.
    joints = np.stack([np.zeros_like(lift), 0.3 * lift, -0.6 * lift], axis=2)
    return home + joints.reshape(len(times), 12)


def print_accuracy() -> None:
    """Print a line for each setting."""
    import jax
    import jax.numpy as jnp

    from quadwalk.env.env import QuadrupedEnv
    from quadwalk.physics.fast import compute_lowest_points
    from quadwalk.physics.motor import PhysicsState
    from quadwalk.robot.quadruped import load_quadruped
    from quadwalk.tasks.sprint import TASK

    quadruped = load_quadruped()
    config = TASK.env
    env = QuadrupedEnv(quadruped, config)
    keys = jax.random.split(jax.random.PRNGKey(0), ROBOTS)
    starts = jax.device_get(jax.jit(jax.vmap(env.reset))(keys)).pipeline_state.physics
    wanted = targets(env.robot.home_joints)

    def in_mujoco(dt: float) -> np.ndarray:
        model = quadruped.make_training_model(dt, iterations=100, ls_iterations=50)
        model.opt.tolerance = 1e-12
        pairs = zip(starts.qpos, starts.qvel, strict=True)
        return np.array([list(_trot(env, model, q, v, wanted)) for q, v in pairs])

    def by(engine: EngineName, iterations: int, line_search: int, substeps: int = 5) -> np.ndarray:
        # The model's contact stiffness depends on the step.
        changed = dataclasses.replace(
            config,
            solver_iterations=iterations,
            line_search_iterations=line_search,
            substeps=substeps,
            physics_dt=CONTROL / substeps,
        )
        stepped = QuadrupedEnv(quadruped, changed, engine)
        step_in = functools.partial(ENGINES[engine].step, stepped.model, stepped.stepping)

        def step(state: PhysicsState, target: jax.Array) -> tuple[PhysicsState, jax.Array]:
            after, _ = step_in(state, target)
            soles, _ = compute_lowest_points(env.model, after.qpos)
            return after, jnp.concatenate([after.qpos[:3], after.qvel[:3], soles[:, 2]])

        course = jax.vmap(lambda s: jax.lax.scan(step, s, jnp.asarray(wanted, jnp.float32))[1])
        return np.asarray(jax.jit(course)(starts))

    rows: dict[str, Callable[[], np.ndarray]] = {
        "MuJoCo C, 4 ms, converged": lambda: in_mujoco(0.004),
        "MJX, 4 ms, 4 iterations": lambda: by("mjx", 4, 1),
        **{
            f"fast, {20 / n:g} ms, {i} iteration{'s' * (i > 1)}, line search {k}": (
                functools.partial(by, "fast", i, k, n)
            )
            for i, k, n in [(1, 1, 5), (2, 1, 5), (3, 1, 5), (4, 1, 5), (8, 8, 5), (4, 1, 4)]
        },
    }
    expected = in_mujoco(0.001)
    print(f"after {SECONDS:g} s of trotting, against MuJoCo C at 1 ms; means of {ROBOTS} starts")
    print(f"{'':42}{'position':>10}{'velocity':>10}{'deepest foot':>14}")
    for name, run in {"MuJoCo C, 1 ms, converged": lambda: expected, **rows}.items():
        found = run()
        position = np.linalg.norm(found[:, -1, :3] - expected[:, -1, :3], axis=1).mean()
        velocity = np.linalg.norm(found[..., 3:6] - expected[..., 3:6], axis=2).mean()
        depth = -found[..., 6:].min(axis=(1, 2)).mean()
        print(f"{name:42}{1e3 * position:7.1f} mm{velocity:6.3f} m/s{1e3 * depth:11.1f} mm")


def _trot(env, model, qpos, qvel, wanted) -> Iterator[np.ndarray]:
    """Per control step: the trunk's position and velocity, and heights of the soles, m, m/s."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    geoms = [model.geom(name).id for name in env.quadruped.feet]
    for target in wanted:
        _advance(model, data, env.motor, target, round(CONTROL / model.opt.timestep))
        mujoco.mj_kinematics(model, data)
        feet = data.geom_xpos[geoms, 2] - model.geom_size[geoms, 0]
        yield np.r_[data.qpos[:3], data.qvel[:3], feet]


FRICTIONS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.8, 1.25)
# Velocities that a robot gets: along world x and y, m/s, and about z, rad/s.
KICKS = {
    "ahead": (1.0, 0.0, 0.0),
    "diagonally": (0.7, 0.7, 0.0),
    "sideways": (0.0, 1.0, 0.0),
    "spinning": (0.0, 0.0, 3.0),
    "ahead, turning": (0.8, 0.3, 2.0),
    "ahead, 10 degrees downhill": (1.0, 0.0, 0.0),
}
DOWNHILL = np.radians(10.0)
STANDING, SLIDING = 150, 38  # physics steps


def print_sliding() -> None:
    """Print the speed that sliding robots lose, relative to MuJoCo C, for each solver setting."""
    import jax
    import jax.numpy as jnp

    from quadwalk.physics import fast
    from quadwalk.physics.motor import MotorConfig, PhysicsState, Stepping, make_motor
    from quadwalk.robot.quadruped import load_quadruped

    quadruped = load_quadruped()
    home = quadruped.home
    target = jnp.asarray(home[7:], jnp.float32)

    def gravity(name: str) -> tuple[float, float, float]:
        angle = DOWNHILL if "downhill" in name else 0.0
        return 9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle)

    def slide_in_mujoco(friction: float, name: str) -> np.ndarray:
        model = quadruped.make_training_model(0.004, iterations=100, ls_iterations=50)
        motor = make_motor(model, quadruped, MotorConfig())
        model.opt.tolerance = 1e-12
        model.geom_friction[:, 0] = friction
        data = mujoco.MjData(model)
        data.qpos[:] = home
        _advance(model, data, motor, home[7:], STANDING)
        model.opt.gravity[:] = gravity(name)
        data.qvel[[0, 1, 5]] += KICKS[name]
        _advance(model, data, motor, home[7:], SLIDING)
        return data.qvel[[0, 1, 5]].copy()

    def slide_in_fast(iterations: int, line_search: int) -> np.ndarray:
        model = quadruped.make_training_model(0.004, iterations, line_search)
        robot = fast.make_model(model, quadruped, make_motor(model, quadruped, MotorConfig()))
        stand = Stepping(0.004, STANDING, iterations, line_search)
        slide = dataclasses.replace(stand, substeps=SLIDING)

        def lose(friction: jax.Array, kick: jax.Array, down: jax.Array) -> jax.Array:
            feet = dataclasses.replace(robot.contacts[0], friction=jnp.broadcast_to(friction, 4))
            level = robot._replace(contacts=(feet,))
            state = PhysicsState(jnp.asarray(home, jnp.float32), jnp.zeros(18))
            state, _ = fast.step(level, stand, state, target)
            state = state._replace(qvel=state.qvel.at[jnp.array([0, 1, 5])].add(kick))
            tilted = level._replace(gravity=(down[0], down[1], down[2]))
            state, _ = fast.step(tilted, slide, state, target)
            return state.qvel[jnp.array([0, 1, 5])]

        kicks = [kick for kick in KICKS.values() for _ in FRICTIONS]
        down = [gravity(name) for name in KICKS for _ in FRICTIONS]
        cases = (jnp.asarray(x, jnp.float32) for x in (np.tile(FRICTIONS, len(KICKS)), kicks, down))
        return np.asarray(jax.jit(jax.vmap(lose))(*cases))

    kicks = np.repeat(list(KICKS.values()), len(FRICTIONS), axis=0)
    size = np.linalg.norm(kicks, axis=1)
    converged = np.array([slide_in_mujoco(mu, name) for name in KICKS for mu in FRICTIONS])
    remaining = (converged * kicks).sum(axis=1) / size
    loss = (size - remaining).reshape(len(KICKS), -1)
    loss[-1] = loss[0]  # gravity gives back downhill what friction takes
    print(f"\n{'speed lost, relative to MuJoCo C':58}" + "".join(f"{mu:>7}" for mu in FRICTIONS))
    for iterations, line_search in [(2, 3), (3, 1), (4, 1), (8, 8)]:
        after = slide_in_fast(iterations, line_search)
        more = (remaining - (after * kicks).sum(axis=1) / size).reshape(len(KICKS), -1)
        for name, row in zip(KICKS, 1.0 + more / loss, strict=True):
            title = f"fast, {iterations} iterations, line search {line_search}: {name}"
            print(f"{title:58}" + "".join(f"{x:7.2f}" for x in row))


def _advance(model, data, motor, target, steps: int) -> None:
    """Step MuJoCo C with the joint controller to `target` (12,), rad."""
    from quadwalk.physics.motor import compute_friction_torque, compute_motor_torque

    for _ in range(steps):
        q, qd = data.qpos[7:], data.qvel[6:]
        data.qfrc_applied[6:] = compute_motor_torque(
            motor, target, q, qd
        ) + compute_friction_torque(motor, qd)
        mujoco.mj_step(model, data)


if __name__ == "__main__":
    set_up_devices()
    print_accuracy()
    print_sliding()
