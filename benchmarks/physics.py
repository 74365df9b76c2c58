"""Physics steps per second: the fast engine, MJX and MuJoCo C on all cores.

    python benchmarks/physics.py [--envs 2048] [--rounds 5] [--variants] [--processor-time]

All three step the training model from the same states with the same torques, in turn, in one run.
What counts is the median of the ratios, since a machine's speed drifts. MuJoCo C is
`mujoco.rollout` with one thread per core and the training model's own solver settings.

`--variants` adds what the fast engine would be without each of its measures; docs/physics.md has
figures. On a machine that others use too, --processor-time counts what the cores spent on it. The
rest of the difference to MJX is the layout, robots innermost, and the matrices: MJX factors dense
ones of 18 x 18 through LAPACK, here they are arrows of four 3 x 3 blocks and one of 6 x 6.
"""

import dataclasses
import time
from collections.abc import Callable
from unittest import mock

import jax
import jax.numpy as jnp
import mujoco
import mujoco.rollout
import numpy as np

from benchmarks.shared import make_fast_step, make_parser, map_over_cores, measure_in_turn
from quadwalk.cores import count_cores
from quadwalk.env.env import QuadrupedEnv
from quadwalk.learn.devices import set_up_devices
from quadwalk.physics import batching, fast, solver
from quadwalk.physics.mjx import mjx
from quadwalk.physics.motor import PhysicsState
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.tasks import sprint

Step = Callable[[PhysicsState, jax.Array], jax.Array]


def main() -> None:
    """Print the physics steps per second of each engine."""
    parser = make_parser(__doc__)
    parser.add_argument("--envs", type=int, default=2048)
    parser.add_argument("--steps", type=int, default=50, help="physics steps in a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--variants", action="store_true")
    parser.add_argument("--processor-time", action="store_true", help="for a busy machine")
    options = parser.parse_args()
    set_up_devices()

    env = QuadrupedEnv(load_quadruped(), sprint.TASK.env)
    keys = jax.random.split(jax.random.PRNGKey(0), options.envs)
    physics = jax.device_get(jax.jit(jax.vmap(env.reset))(keys)).pipeline_state.physics
    rng = np.random.default_rng(0)
    torques = rng.normal(0, 5, (options.envs, options.steps, 12)).astype(np.float32)

    def read_clock() -> float:
        if options.processor_time:
            return time.process_time() / count_cores()
        return time.perf_counter()

    def make_measure(step: Step) -> Callable[[], float]:
        program = map_over_cores(step)

        def measure() -> float:
            began = read_clock()
            jax.block_until_ready(program(physics, jnp.asarray(torques)))
            return torques[..., 0].size / (read_clock() - began)

        return measure

    threads = [mujoco.MjData(env.mj_model) for _ in range(count_cores())]
    states = np.concatenate([np.zeros((options.envs, 1)), physics.qpos, physics.qvel], axis=1)
    with mujoco.rollout.Rollout(nthread=len(threads)) as pool:

        def measure_mujoco() -> float:
            began = read_clock()
            pool.rollout(env.mj_model, threads, states, torques)
            return torques[..., 0].size / (read_clock() - began)

        measures = {"fast": make_measure(make_fast_step(env.model, env.stepping))}
        if options.variants:
            measures |= make_variants(env, options.envs, make_measure)
        measures |= {"MJX": make_measure(make_mjx_step(env)), "MuJoCo C": measure_mujoco}
        rates = measure_in_turn(measures, options.rounds)

    print(f"{options.envs} environments, {count_cores()} cores, medians of {options.rounds} rounds")
    for name, rate in rates.items():
        ratio = np.median(rate / rates["MuJoCo C"])
        print(f"{name:18}{np.median(rate):12,.0f} steps/s{ratio:8.2f} x MuJoCo C")


def make_mjx_step(env: QuadrupedEnv) -> Step:
    """Return a function that steps a robot in MJX and returns its last qpos (19,).

    Its arguments are those of `make_fast_step`'s.
    """
    model = mjx.put_model(env.mj_model)

    def step_all(state: PhysicsState, torques: jax.Array) -> jax.Array:
        blank = mjx.make_data(model)

        def step(state: PhysicsState, torque: jax.Array) -> tuple[PhysicsState, None]:
            data = blank.replace(qpos=state.qpos, qvel=state.qvel, ctrl=torque)
            data = mjx.step(model, data)
            return PhysicsState(data.qpos, data.qvel), None

        return jax.lax.scan(step, state, torques)[0].qpos

    return step_all


def make_variants(
    env: QuadrupedEnv, envs: int, make_measure: Callable[[Step], Callable[[], float]]
) -> dict[str, Callable[[], float]]:
    """Return by name functions that measure variants of the fast engine, in steps per second.

    Variants have other settings, or lack what makes it fast. `make_measure` turns a function that
    steps into one that measures it.
    """

    def make_variant(**changes: int) -> Callable[[], float]:
        return make_measure(make_fast_step(env.model, dataclasses.replace(env.stepping, **changes)))

    config = dataclasses.replace(sprint.TASK.env, contacts="body")
    body = QuadrupedEnv(env.quadruped, config)
    unbatched, plain = make_variant(), make_variant()
    # Each is compiled at its first call, while a module's value is another.
    with mock.patch.object(batching, "BATCH", envs):
        unbatched()
    with (
        mock.patch.object(solver, "materialize", call_plainly),
        mock.patch.object(fast, "materialize", call_plainly),
    ):
        plain()
    return {
        "2 iterations": make_variant(iterations=2),
        "3 iterations": make_variant(iterations=3),
        "body": make_measure(make_fast_step(body.model, body.stepping)),
        "no batches": unbatched,
        "not materialized": plain,
    }


def call_plainly(barrier: object, function: Callable[..., object], *arguments: object) -> object:
    """Return the result of `function`: in place of `materialize`, without its barrier."""
    return function(*arguments)


if __name__ == "__main__":
    main()
