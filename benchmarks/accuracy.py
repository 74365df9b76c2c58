"""What cutting physics short costs: errors after a second of trotting, by solver setting.

    python benchmarks/accuracy.py

The reference is MuJoCo C at 1 ms, its solver run until it has converged. From the same 16 starts
and with the same joint targets each setting trots for a second; printed are the distance between
the trunk's positions at the end, the mean distance between its velocities, and how deep feet sank.
Part of the error at 4 ms is the step's, whatever the solver: the row of MuJoCo C at 4 ms.

                                              position  velocity  deepest foot
    MuJoCo C, 1 ms, converged                   0.0 mm 0.000 m/s        6.9 mm
    MuJoCo C, 4 ms, converged                   5.9 mm 0.011 m/s        5.5 mm
    MJX, 4 ms, 1 iteration                     43.8 mm 0.067 m/s        5.8 mm
    fast, 4 ms, 1 iteration                    47.3 mm 0.071 m/s        5.7 mm
    fast, 4 ms, 2 iterations                   11.0 mm 0.018 m/s        5.4 mm
    fast, 4 ms, 3 iterations                    7.4 mm 0.013 m/s        5.6 mm
    fast, 5 ms, 2 iterations                   12.9 mm 0.022 m/s        5.5 mm

Two iterations were chosen; three evaluations of the line search serve as well as five.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from quadwalk.physics.engines import ENGINES, EngineName
from quadwalk.train.devices import set_up_devices

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

    from quadwalk.physics.fast import lowest_points
    from quadwalk.physics.motor import PhysicsState
    from quadwalk.robot.quadruped import load_quadruped
    from quadwalk.task.env import QuadrupedEnv
    from quadwalk.tasks.sprint import TASK

    quadruped = load_quadruped()
    config = TASK.env
    env = QuadrupedEnv(quadruped, config)
    keys = jax.random.split(jax.random.PRNGKey(0), ROBOTS)
    starts = jax.device_get(jax.jit(jax.vmap(env.reset))(keys)).pipeline_state.physics
    wanted = targets(env.robot.home_joints)

    def in_mujoco(dt: float) -> np.ndarray:
        model = quadruped.training_model(dt, iterations=100, ls_iterations=50)
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
        step_in = functools.partial(ENGINES[engine].control_step, stepped.model, stepped.stepping)

        def step(state: PhysicsState, target: jax.Array) -> tuple[PhysicsState, jax.Array]:
            after, _ = step_in(state, target)
            soles, _ = lowest_points(env.model, after.qpos)
            return after, jnp.concatenate([after.qpos[:3], after.qvel[:3], soles[:, 2]])

        course = jax.vmap(lambda s: jax.lax.scan(step, s, jnp.asarray(wanted, jnp.float32))[1])
        return np.asarray(jax.jit(course)(starts))

    rows: dict[str, Callable[[], np.ndarray]] = {
        "MuJoCo C, 4 ms, converged": lambda: in_mujoco(0.004),
        "MJX, 4 ms, 1 iteration, line search 3": lambda: by("mjx", 1, 3),
        **{
            f"fast, {20 / n:g} ms, {i} iteration{'s' * (i > 1)}, line search {k}": (
                functools.partial(by, "fast", i, k, n)
            )
            for i, k, n in [(1, 5, 5), (1, 3, 5), (2, 3, 5), (3, 3, 5), (8, 8, 5), (2, 3, 4)]
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
    from quadwalk.physics.motor import friction_torque, motor_torque

    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    geoms = [model.geom(name).id for name in env.quadruped.feet]
    for target in wanted:
        for _ in range(round(CONTROL / model.opt.timestep)):
            q, qd = data.qpos[7:], data.qvel[6:]
            torque = motor_torque(env.motor, target, q, qd) + friction_torque(env.motor, qd)
            data.qfrc_applied[6:] = torque
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        feet = data.geom_xpos[geoms, 2] - model.geom_size[geoms, 0]
        yield np.r_[data.qpos[:3], data.qvel[:3], feet]


if __name__ == "__main__":
    set_up_devices()
    print_accuracy()
