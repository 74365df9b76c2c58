"""What uneven ground costs: physics steps of the fast engine over a field and on a flat floor.

    python benchmarks/ground.py [--envs 512] [--rounds 1000]

Feet alone touch, or knees too, or those and the trunk. The field is that of ten kinds at ten
levels, 88 x 88 m, and the robots stand all over it. Rounds alternate and are short, and the least
time of each counts: what else a machine does only ever adds to it.
"""

import argparse
import dataclasses
import time

import numpy as np

from quadwalk.cores import cpu_cores
from quadwalk.learn.devices import set_up_devices


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--envs", type=int, default=512)
    parser.add_argument("--steps", type=int, default=10, help="physics steps in a round")
    parser.add_argument("--rounds", type=int, default=1000)
    options = parser.parse_args()
    set_up_devices()
    print_costs(options.envs, options.steps, options.rounds)


def print_costs(envs: int, steps: int, rounds: int) -> None:
    """Print the time of a physics step on a flat floor and over the field, and their ratio."""
    import jax
    import jax.numpy as jnp

    from quadwalk.learn.devices import AXIS, make_mesh
    from quadwalk.physics.batching import batch_robots
    from quadwalk.physics.fast import compute_acceleration, integrate, make_model
    from quadwalk.physics.model import Model, add_ground
    from quadwalk.physics.motor import MotorConfig, PhysicsState, make_motor
    from quadwalk.robot.quadruped import load_quadruped
    from quadwalk.terrain.terrain import FLAT, make_terrain
    from quadwalk.terrain.tiles import KINDS

    quadruped = load_quadruped()
    terrain = make_terrain(dataclasses.replace(FLAT, kinds=tuple(KINDS)), leg=0.5)
    rng = np.random.default_rng(0)
    qpos = np.tile(quadruped.home, (envs, 1))
    places = [tile.middle for tile in terrain.tiles]
    qpos[:, :2] = np.resize(places, (envs, 2)) + rng.uniform(-3, 3, (envs, 2))
    raised = qpos + terrain.field.height_at(qpos[:, :2])[:, None] * np.eye(19)[2]
    qvel = rng.normal(0, 0.5, (envs, 18))
    torques = rng.normal(0, 5, (envs, steps, 12))
    split = jax.sharding.PartitionSpec(AXIS)
    mesh = make_mesh()

    def program(model: Model, qpos: np.ndarray):
        def of_many(model: Model, state: PhysicsState, torques: jax.Array) -> jax.Array:
            def step(state: PhysicsState, torque: jax.Array) -> tuple[PhysicsState, None]:
                qacc = compute_acceleration(model, state, torque, 4, 1, 0.004)
                return integrate(state, qacc, 0.004), None

            return jax.lax.scan(step, state, torques)[0].qpos

        like = jax.ShapeDtypeStruct((19,), np.float32)
        function = jax.vmap(lambda *arguments: batch_robots(of_many, like)(model, *arguments))
        mapped = jax.shard_map(
            function, mesh=mesh, in_specs=split, out_specs=split, check_vma=False
        )
        state = PhysicsState(*(jnp.asarray(x, jnp.float32) for x in (qpos, qvel)))
        compiled = jax.jit(mapped)
        given = (state, jnp.asarray(torques, jnp.float32))

        def measure() -> float:
            began = time.perf_counter()
            jax.block_until_ready(compiled(*given))
            return time.perf_counter() - began

        return measure

    cases = {}
    for contacts in ("feet", "knees", "body"):
        mj_model = quadruped.make_training_model(0.004, 2, 3, contacts)
        level = make_model(mj_model, quadruped, make_motor(mj_model, quadruped, MotorConfig()))
        cases[f"{contacts}, flat floor"] = program(level, qpos)
        cases[f"{contacts}, field"] = program(add_ground(level, terrain.field), raised)
    for measure in cases.values():
        measure()  # compile, warm up
    least = np.min([[measure() for measure in cases.values()] for _ in range(rounds)], axis=0)
    print(f"{envs} robots, {cpu_cores()} cores, the least of {rounds} rounds")
    flat = np.repeat(least[::2], 2)  # of a field, the case before it
    for name, seconds, on_flat in zip(cases, least, flat, strict=True):
        each = 1e6 * seconds / (envs * steps) * cpu_cores()
        print(f"{name:18}{each:7.2f} microseconds of a core{seconds / on_flat:7.2f} x flat")


if __name__ == "__main__":
    main()
