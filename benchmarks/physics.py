"""Physics steps per second: the fast engine, MJX and MuJoCo C on all cores.

    python benchmarks/physics.py [--envs 2048] [--rounds 5] [--variants] [--processor-time]
    python benchmarks/accuracy.py

The rates: all three step the training model from the same states with the same torques, in turn,
in one run; what counts is the median of the ratios, since a machine's speed drifts. MuJoCo C is
`mujoco.rollout` with one thread per core and the training model's own solver settings.

`--variants` adds what the fast engine would be without each of its measures; docs/physics.md has
figures. On a machine that others use too, --processor-time counts what the cores spent on it. The
rest of the difference to MJX is the layout, robots innermost, and the matrices: MJX factors dense
ones of 18 x 18 through LAPACK, here they are arrows of four 3 x 3 blocks and one of 6 x 6.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable, Mapping
from types import ModuleType

import numpy as np

from quadwalk.cores import cpu_cores
from quadwalk.learn.devices import set_up_devices
from quadwalk.physics import batching, fast, solver


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--envs", type=int, default=2048)
    parser.add_argument("--steps", type=int, default=50, help="physics steps in a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--variants", action="store_true")
    parser.add_argument("--processor-time", action="store_true", help="for a busy machine")
    options = parser.parse_args()
    set_up_devices()
    clock = time.perf_counter
    if options.processor_time:
        clock = lambda: time.process_time() / cpu_cores()  # noqa: E731
    print_rates(options.envs, options.steps, options.rounds, options.variants, clock)


def print_rates(
    envs: int, steps: int, rounds: int, variants: bool, clock: Callable[[], float]
) -> None:
    """Print the median rate of each engine by `clock` and its ratio to MuJoCo C's."""
    import jax
    import jax.numpy as jnp
    import mujoco
    import mujoco.rollout

    from quadwalk.env.env import QuadrupedEnv
    from quadwalk.learn.devices import AXIS, make_mesh
    from quadwalk.physics.batching import batch_robots
    from quadwalk.physics.fast import compute_acceleration, integrate
    from quadwalk.physics.mjx import mjx
    from quadwalk.physics.model import Model
    from quadwalk.physics.motor import PhysicsState
    from quadwalk.robot.quadruped import load_quadruped
    from quadwalk.tasks.sprint import TASK

    env = QuadrupedEnv(load_quadruped(), TASK.env)
    whole = QuadrupedEnv(load_quadruped(), dataclasses.replace(TASK.env, contacts="body"))
    start = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), envs))
    physics = jax.device_get(start.pipeline_state.physics)
    rng = np.random.default_rng(0)
    torques = rng.normal(0, 5, (envs, steps, 12)).astype(np.float32)

    mjx_model = mjx.put_model(env.mj_model)

    def in_fast(iterations: int = env.stepping.iterations, model: Model = env.model):
        def of_many(model: Model, state: PhysicsState, torques: jax.Array) -> jax.Array:
            def step(state: PhysicsState, torque: jax.Array) -> tuple[PhysicsState, None]:
                dt, searched = env.stepping.dt, env.stepping.line_search
                qacc = compute_acceleration(model, state, torque, iterations, searched, dt)
                return integrate(state, qacc, dt), None

            return jax.lax.scan(step, state, torques)[0].qpos

        like = jax.ShapeDtypeStruct((19,), np.float32)
        return lambda *arguments: batch_robots(of_many, like)(model, *arguments)

    def in_mjx(state: PhysicsState, torques: jax.Array) -> jax.Array:
        blank = mjx.make_data(mjx_model)

        def step(state: PhysicsState, torque: jax.Array) -> tuple[PhysicsState, None]:
            data = blank.replace(qpos=state.qpos, qvel=state.qvel)
            data = mjx.step(mjx_model, data.replace(ctrl=torque))
            return PhysicsState(data.qpos, data.qvel), None

        return jax.lax.scan(step, state, torques)[0].qpos

    split = jax.sharding.PartitionSpec(AXIS)

    def rate(function):
        program = jax.jit(
            jax.shard_map(
                jax.vmap(function),
                mesh=make_mesh(),
                in_specs=split,
                out_specs=split,
                check_vma=False,
            )
        )

        def measure() -> float:
            began = clock()
            jax.block_until_ready(program(physics, jnp.asarray(torques)))
            return envs * steps / (clock() - began)

        return measure

    model = env.mj_model
    data = [mujoco.MjData(model) for _ in range(cpu_cores())]
    states = np.concatenate([np.zeros((envs, 1)), physics.qpos, physics.qvel], axis=1)

    with mujoco.rollout.Rollout(nthread=len(data)) as pool:

        def in_mujoco() -> float:
            began = clock()
            pool.rollout(model, data, states, torques)
            return envs * steps / (clock() - began)

        def with_other(values: Mapping[tuple[ModuleType, str], object], measure):
            """`measure`, compiled while modules have other values."""
            kept = {(module, name): getattr(module, name) for module, name in values}
            for (module, name), value in values.items():
                setattr(module, name, value)
            measure()
            for (module, name), value in kept.items():
                setattr(module, name, value)
            return measure

        engines = {"fast": rate(in_fast())}
        if variants:
            plain = {(module, "materialize"): _plain for module in (solver, fast)}
            engines |= {
                "2 iterations": rate(in_fast(2)),
                "3 iterations": rate(in_fast(3)),
                "body": rate(in_fast(model=whole.model)),
                "no batches": with_other({(batching, "BATCH"): envs}, rate(in_fast())),
                "not materialized": with_other(plain, rate(in_fast())),
            }
        engines |= {"MJX": rate(in_mjx), "MuJoCo C": in_mujoco}
        for measure in engines.values():
            measure()  # compile, warm up
        found = np.array([[measure() for measure in engines.values()] for _ in range(rounds)])

    print(f"{envs} environments, {cpu_cores()} cores, medians of {rounds} rounds")
    for name, column in zip(engines, found.T, strict=True):
        ratio = np.median(column / found[:, -1])
        print(f"{name:18}{np.median(column):12,.0f} steps/s{ratio:8.2f} x MuJoCo C")


def _plain(barrier, function, *arguments):
    """`materialize`, without what it is for."""
    return function(*arguments)


if __name__ == "__main__":
    main()
