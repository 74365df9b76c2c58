"""The training that `python train.py` does by default, without the run around it."""

import time
from typing import NamedTuple

from quadwalk.learn.devices import count_devices, cpu_cores, set_up_devices
from quadwalk.settings.training import PPOConfig
from quadwalk.tasks import sprint

SUBSTEPS = sprint.TASK.env.substeps  # physics steps in a control step
CONTROL_DT = sprint.TASK.env.control_dt  # s


class Timed(NamedTuple):
    """What a stretch of training took."""

    steps: int  # control steps of the environments that are learned from
    seconds: float


class DefaultTraining:
    """`envs` environments that learn on all cores this process may use; ready when made."""

    def __init__(self, envs: int, config: PPOConfig | None = None, seed: int = 0) -> None:
        config = config or sprint.TASK.ppo
        self.devices = count_devices(envs, config.minibatches, config.eval_envs, cpu_cores())
        set_up_devices(self.devices)
        from quadwalk.env.env import QuadrupedEnv
        from quadwalk.learn.devices import make_mesh
        from quadwalk.learn.networks import make_env_networks
        from quadwalk.learn.ppo import Iteration, init_state
        from quadwalk.robot.quadruped import load_quadruped

        env = QuadrupedEnv(load_quadruped(), sprint.TASK.env)
        networks = make_env_networks(env, config)
        mesh = make_mesh()
        self._state = init_state(env, networks, config, mesh, envs, seed)
        # Of how many only tells the learning rate's schedule when to settle.
        self._iterate = Iteration(env, networks, config, mesh, iterations=1000)
        self._batch = envs * config.unroll
        self.run(0.0)  # compiles, and measures the observations
        self.run(0.0)

    def run(self, seconds: float) -> Timed:
        """Train for so long, at least one iteration."""
        import jax

        began = time.perf_counter()
        iterations = 0
        while not iterations or time.perf_counter() - began < seconds:
            self._state, _ = jax.block_until_ready(self._iterate(self._state))
            iterations += 1
        return Timed(iterations * self._batch, time.perf_counter() - began)

    def run_parts(self, seconds: float) -> tuple[Timed, Timed]:
        """The same, with collecting and learning timed apart."""
        import jax

        from quadwalk.learn.ppo import TrainState

        began, iterations = time.perf_counter(), 0
        collecting = learning = 0.0
        while not iterations or time.perf_counter() - began < seconds:
            start = time.perf_counter()
            iterate, state = self._iterate, self._state
            workers, rollout, _, key = jax.block_until_ready(iterate.collect(*state))
            middle = time.perf_counter()
            learner, _ = jax.block_until_ready(
                self._iterate.learn(self._state.learner, rollout, key)
            )
            self._state = TrainState(learner, workers)
            collecting += middle - start
            learning += time.perf_counter() - middle
            iterations += 1
        steps = iterations * self._batch
        return Timed(steps, collecting), Timed(steps, learning)
