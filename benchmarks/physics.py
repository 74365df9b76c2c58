"""Physics steps per second: MJX on all cores against MuJoCo C on as many threads.

    python benchmarks/physics.py [--envs 2048] [--rounds 5]

Both step the training model from the same states with the same torques, in turn, in one run; what
counts is the median of the ratios, since a machine's speed drifts. MuJoCo C is `mujoco.rollout`
with the training model's own solver settings, one thread per core.
"""

import argparse
import time

import numpy as np

from quadwalk.train.devices import cpu_cores, set_up_devices


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--envs", type=int, default=2048)
    parser.add_argument("--steps", type=int, default=50, help="physics steps in a round")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    set_up_devices()
    import jax
    import jax.numpy as jnp
    import mujoco
    import mujoco.rollout
    from mujoco import mjx

    from quadwalk.env.config import EnvConfig
    from quadwalk.env.quadruped import QuadrupedEnv
    from quadwalk.robot.quadruped import load_quadruped
    from quadwalk.train.ppo import AXIS, make_mesh

    env = QuadrupedEnv(load_quadruped(), EnvConfig())
    start = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), options.envs))
    physics = jax.device_get(start.pipeline_state.physics)
    rng = np.random.default_rng(0)
    torques = rng.normal(0, 5, (options.envs, options.steps, 12)).astype(np.float32)

    def trajectory(qpos: jax.Array, qvel: jax.Array, torques: jax.Array) -> jax.Array:
        blank = mjx.make_data(env.model)

        def step(state, torque):
            data = blank.replace(qpos=state[0], qvel=state[1], qacc_warmstart=state[2], ctrl=torque)
            data = mjx.step(env.model, data)
            return (data.qpos, data.qvel, data.qacc_warmstart), None

        (qpos, _, _), _ = jax.lax.scan(step, (qpos, qvel, jnp.zeros(18)), torques)
        return qpos

    split = jax.sharding.PartitionSpec(AXIS)
    program = jax.jit(
        jax.shard_map(
            jax.vmap(trajectory), mesh=make_mesh(), in_specs=split, out_specs=split, check_vma=False
        )
    )

    def in_mjx() -> float:
        began = time.perf_counter()
        jax.block_until_ready(program(physics.qpos, physics.qvel, torques))
        return options.envs * options.steps / (time.perf_counter() - began)

    model = env.mj_model
    data = [mujoco.MjData(model) for _ in range(cpu_cores())]
    states = np.concatenate([np.zeros((options.envs, 1)), physics.qpos, physics.qvel], axis=1)

    with mujoco.rollout.Rollout(nthread=len(data)) as pool:

        def in_mujoco() -> float:
            began = time.perf_counter()
            pool.rollout(model, data, states, torques)
            return options.envs * options.steps / (time.perf_counter() - began)

        in_mjx(), in_mujoco()  # compile, warm up
        rounds = np.array([(in_mjx(), in_mujoco()) for _ in range(options.rounds)])

    mjx_rate, native_rate = np.median(rounds, axis=0)
    print(f"{options.envs} environments, {cpu_cores()} cores, medians of {options.rounds} rounds")
    print(f"MJX       {mjx_rate:12,.0f} steps/s")
    print(f"MuJoCo C  {native_rate:12,.0f} steps/s")
    print(f"ratio     {np.median(rounds[:, 0] / rounds[:, 1]):12.2f}")


if __name__ == "__main__":
    main()
