"""Compare the engines with MuJoCo C whose solver has converged: trotting, and sliding.

    python benchmarks/accuracy.py [--robots 16]

Trotting: from the same starts and with the same joint targets each setting trots for a second.
Printed are the distance between the trunk's positions at the end and in MuJoCo C at 1 ms, the mean
distance between its velocities, and how deep feet sank. Part of the error at 4 ms is the step's,
whatever the solver: the row of MuJoCo C at 4 ms.

Sliding: a robot that stands gets a velocity on a slippery floor. Printed is the speed that it loses
within 0.15 s, relative to MuJoCo C with the same steps of 4 ms. Downhill, the difference to
MuJoCo C counts relative to what is lost on level ground.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks.shared import make_parser
from quadwalk.env.env import QuadrupedEnv
from quadwalk.learn.devices import set_up_devices
from quadwalk.physics import fast
from quadwalk.physics.engines import ENGINES, EngineName
from quadwalk.physics.motor import (
    Motor,
    MotorConfig,
    PhysicsState,
    Stepping,
    compute_friction_torque,
    compute_motor_torque,
    make_motor,
)
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.tasks import sprint

DT = 0.004  # s, one physics step of training
# Trotting.
SECONDS = 1.0
CONTROL = 0.02  # s, joint targets hold so long
STRIDES = 2.5  # per second
# Newton iterations, evaluations of the line search, physics steps in a control step.
SETTINGS = [(1, 1, 5), (2, 1, 5), (3, 1, 5), (4, 1, 5), (8, 8, 5), (4, 1, 4)]
# Sliding.
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
KICKED = np.array([0, 1, 5])  # their places in qvel
STANDING, SLIDING = 150, 38  # physics steps


def make_converged_model(quadruped: Quadruped, dt: float) -> mujoco.MjModel:
    """Return the full model for MuJoCo C, with solver iterations enough to converge."""
    model = quadruped.make_training_model(dt, iterations=100, ls_iterations=50)
    model.opt.tolerance = 1e-12
    return model


def step_mujoco(
    model: mujoco.MjModel, data: mujoco.MjData, motor: Motor, target: np.ndarray, steps: int
) -> None:
    """Take physics steps in MuJoCo C, in place; the motors hold `target` (12,), rad."""
    for _ in range(steps):
        q, qd = data.qpos[7:], data.qvel[6:]
        data.qfrc_applied[6:] = compute_motor_torque(
            motor, target, q, qd
        ) + compute_friction_torque(motor, qd)
        mujoco.mj_step(model, data)


def make_trot(home: np.ndarray) -> np.ndarray:
    """Return joint targets (steps, 12), rad, of a trot on the spot: diagonal feet in turn.

    `home` (12,), rad, are the joint angles of a stand. Each row holds for `CONTROL`.
    """
    times = np.arange(0, SECONDS, CONTROL)[:, None]
    lift = np.maximum(np.sin(2 * np.pi * STRIDES * times + np.pi * np.array([0, 1, 1, 0])), 0.0)
    # A thigh forward and a calf folded by twice that lift the foot straight up.
    joints = np.stack([np.zeros_like(lift), 0.3 * lift, -0.6 * lift], axis=2)
    return home + joints.reshape(len(times), 12)


def trot_in_mujoco(
    env: QuadrupedEnv, dt: float, starts: PhysicsState, targets: np.ndarray
) -> np.ndarray:
    """Simulate a trot in MuJoCo C; return the trunk's motion and the heights of the soles.

    They are one array (robots, control steps, 10): position, m, velocity, m/s, and four heights, m.
    `dt`, s, is a physics step; `targets` (control steps, 12) are in rad.
    """
    model = make_converged_model(env.quadruped, dt)
    geoms = [model.geom(name).id for name in env.quadruped.feet]
    data = mujoco.MjData(model)
    courses = []
    for qpos, qvel in zip(starts.qpos, starts.qvel, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        rows = []
        for target in targets:
            step_mujoco(model, data, env.motor, target, round(CONTROL / dt))
            mujoco.mj_kinematics(model, data)
            soles = data.geom_xpos[geoms, 2] - model.geom_size[geoms, 0]
            rows.append(np.concatenate([data.qpos[:3], data.qvel[:3], soles]))
        courses.append(rows)
    return np.array(courses)


def trot_in_engine(
    env: QuadrupedEnv,
    engine: EngineName,
    setting: tuple[int, int, int],
    starts: PhysicsState,
    targets: np.ndarray,
) -> np.ndarray:
    """Simulate a trot in `engine`; return the trunk's motion and the heights of the soles.

    They are one array, as of `trot_in_mujoco`. `setting` is one of `SETTINGS`.
    """
    iterations, line_search, substeps = setting
    # The model's contact stiffness depends on the step.
    config = dataclasses.replace(
        env.config,
        solver_iterations=iterations,
        line_search_iterations=line_search,
        substeps=substeps,
        physics_dt=CONTROL / substeps,
    )
    changed = QuadrupedEnv(env.quadruped, config, engine)

    def step(state: PhysicsState, target: jax.Array) -> tuple[PhysicsState, jax.Array]:
        after, _ = ENGINES[engine].step(changed.model, changed.stepping, state, target)
        soles, _ = fast.compute_lowest_points(env.model, after.qpos)
        return after, jnp.concatenate([after.qpos[:3], after.qvel[:3], soles[:, 2]])

    def trot(state: PhysicsState) -> jax.Array:
        return jax.lax.scan(step, state, jnp.asarray(targets, jnp.float32))[1]

    return np.asarray(jax.jit(jax.vmap(trot))(starts))


def print_trotting(robots: int) -> None:
    """Print how far each setting of the engines is from MuJoCo C after a second of trotting.

    Distances of position and velocity are means over so many `robots`, each with its own start.
    """
    env = QuadrupedEnv(load_quadruped(), sprint.TASK.env)
    keys = jax.random.split(jax.random.PRNGKey(0), robots)
    starts = jax.device_get(jax.jit(jax.vmap(env.reset))(keys)).pipeline_state.physics
    targets = make_trot(env.robot.home_joints)
    expected = trot_in_mujoco(env, 0.001, starts, targets)
    courses = {
        "MuJoCo C, 1 ms, converged": expected,
        "MuJoCo C, 4 ms, converged": trot_in_mujoco(env, DT, starts, targets),
        "MJX, 4 ms, 4 iterations": trot_in_engine(env, "mjx", (4, 1, 5), starts, targets),
    }
    for setting in SETTINGS:
        iterations, line_search, substeps = setting
        dt = 1e3 * CONTROL / substeps
        name = f"fast, {dt:g} ms, {iterations} iterations, line search {line_search}"
        courses[name] = trot_in_engine(env, "fast", setting, starts, targets)
    print(f"after {SECONDS:g} s of trotting, against MuJoCo C at 1 ms; means of {robots} starts")
    print(f"{'':42}{'position':>10}{'velocity':>10}{'deepest foot':>14}")
    for name, course in courses.items():
        error = course - expected
        position = np.linalg.norm(error[:, -1, :3], axis=1).mean()
        velocity = np.linalg.norm(error[..., 3:6], axis=2).mean()
        depth = -course[..., 6:].min(axis=(1, 2)).mean()
        print(f"{name:42}{1e3 * position:7.1f} mm{velocity:6.3f} m/s{1e3 * depth:11.1f} mm")


def make_gravity(kick: str) -> np.ndarray:
    """Return gravity (3,), m/s^2, in the case `kick` of `KICKS`: tilted for the one downhill."""
    slope = np.radians(10.0) if "downhill" in kick else 0.0
    return 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])


def slide_in_mujoco(quadruped: Quadruped, friction: float, kick: str) -> np.ndarray:
    """Simulate a slide in MuJoCo C; return the trunk's velocity (3,) at the end, as of `KICKS`.

    A robot that stands gets the velocity `kick` of `KICKS`, and slides for `SLIDING` physics steps
    on a floor of this friction.
    """
    model = make_converged_model(quadruped, DT)
    motor = make_motor(model, quadruped, MotorConfig())
    model.geom_friction[:, 0] = friction
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    step_mujoco(model, data, motor, quadruped.home[7:], STANDING)
    model.opt.gravity[:] = make_gravity(kick)
    data.qvel[KICKED] += KICKS[kick]
    step_mujoco(model, data, motor, quadruped.home[7:], SLIDING)
    return data.qvel[KICKED].copy()


def slide_in_fast(
    quadruped: Quadruped, iterations: int, line_search: int, cases: list[tuple[str, float]]
) -> np.ndarray:
    """Simulate slides in the fast engine; return the trunk's velocities (n, 3) at the end.

    They are as of `KICKS`. The n `cases` are pairs of a name in `KICKS` and the floor's friction.
    The solver takes `iterations` of Newton, each with `line_search` evaluations.
    """
    mj_model = quadruped.make_training_model(DT, iterations, line_search)
    model = fast.make_model(mj_model, quadruped, make_motor(mj_model, quadruped, MotorConfig()))
    standing = Stepping(DT, STANDING, iterations, line_search)
    sliding = dataclasses.replace(standing, substeps=SLIDING)
    target = jnp.asarray(quadruped.home[7:], jnp.float32)
    start = PhysicsState(jnp.asarray(quadruped.home, jnp.float32), jnp.zeros(18))

    def slide(friction: Any, kick: Any, gravity: Any) -> jax.Array:
        feet = dataclasses.replace(model.contacts[0], friction=jnp.broadcast_to(friction, 4))
        slippery = model._replace(contacts=(feet,))
        state, _ = fast.step(slippery, standing, start, target)
        state = state._replace(qvel=state.qvel.at[KICKED].add(kick))
        tilted = slippery._replace(gravity=tuple(gravity))
        state, _ = fast.step(tilted, sliding, state, target)
        return state.qvel[KICKED]

    frictions = jnp.array([friction for _, friction in cases], jnp.float32)
    kicks = jnp.array([KICKS[kick] for kick, _ in cases], jnp.float32)
    gravity = jnp.array([make_gravity(kick) for kick, _ in cases], jnp.float32)
    return np.asarray(jax.jit(jax.vmap(slide))(frictions, kicks, gravity))


def print_sliding() -> None:
    """Print the speed that sliding robots lose, relative to MuJoCo C, for each solver setting."""
    quadruped = load_quadruped()
    cases = [(kick, friction) for kick in KICKS for friction in FRICTIONS]
    kicks = np.array([KICKS[kick] for kick, _ in cases])
    sizes = np.linalg.norm(kicks, axis=1)
    converged = np.array([slide_in_mujoco(quadruped, friction, kick) for kick, friction in cases])
    remaining = (converged * kicks).sum(axis=1) / sizes
    loss = (sizes - remaining).reshape(len(KICKS), -1)
    loss[-1] = loss[0]  # gravity gives back downhill what friction takes
    print(f"\n{'speed lost, relative to MuJoCo C':58}" + "".join(f"{mu:>7}" for mu in FRICTIONS))
    for iterations, line_search in [(2, 3), (3, 1), (4, 1), (8, 8)]:
        after = slide_in_fast(quadruped, iterations, line_search, cases)
        more = (remaining - (after * kicks).sum(axis=1) / sizes).reshape(len(KICKS), -1)
        for name, row in zip(KICKS, 1.0 + more / loss, strict=True):
            title = f"fast, {iterations} iterations, line search {line_search}: {name}"
            print(f"{title:58}" + "".join(f"{x:7.2f}" for x in row))


if __name__ == "__main__":
    parser = make_parser(__doc__)
    parser.add_argument("--robots", type=int, default=16, help="that trot")
    options = parser.parse_args()
    set_up_devices()
    print_trotting(options.robots)
    print_sliding()
