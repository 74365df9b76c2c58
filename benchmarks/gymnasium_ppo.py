"""Stable-Baselines3's PPO on our environments through Gymnasium, and where its time goes.

    pip install -e '.[sb3]'
    python benchmarks/gymnasium_ppo.py [--steps 300000]

It trains on `gymnasium.make_vec("quadwalk/Sprint-v0")` with the networks and batch sizes of ours.
Stepping the environments, the rest of collecting (its policy, its buffer) and learning are timed
apart, and set beside what `python train.py sprint` does of the same on the same cores.
The adapter below is all that Stable-Baselines3 needs.
"""

import time

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

import quadwalk.gym  # noqa: F401 - registers the environments
from benchmarks.shared import TimedTraining, make_parser
from quadwalk.tasks import sprint


class SB3VecEnv(VecEnv):
    """A Gymnasium vector environment that resets in the same step, as SB3's own kind."""

    def __init__(self, envs: gymnasium.vector.VectorEnv) -> None:
        self.envs, self.seconds = envs, 0.0
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self):
        """Reset all environments, by the first of their seeds; return the first observations."""
        observations, _ = self.envs.reset(seed=self._seeds[0])
        return observations

    def step_async(self, actions):
        """Keep the actions for `step_wait`."""
        self.actions = actions

    def step_wait(self):
        """Take a step with the actions of `step_async`, and add its time to `seconds`.

        Returns observations, rewards, ends and infos, as Stable-Baselines3 expects.
        """
        began = time.perf_counter()
        observations, reward, terminated, truncated, infos = self.envs.step(self.actions)
        self.seconds += time.perf_counter() - began
        done = terminated | truncated
        infos_of_each = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            infos_of_each[i] = {
                "terminal_observation": infos["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i]),
            }
        return observations, reward, done, infos_of_each

    def close(self):
        """Close the environments."""
        self.envs.close()

    def env_is_wrapped(self, wrapper_class, indices=None):
        """Return False for each environment: none has a wrapper."""
        return [False] * self.num_envs

    def get_attr(self, attr_name, indices=None):
        """Return an attribute of the vector environment once for each environment, or None."""
        return [getattr(self.envs, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        """Raise an error: there are no attributes to set."""
        raise NotImplementedError("the environments have no attributes of their own")

    def env_method(self, method_name, *args, indices=None, **kwargs):
        """Raise an error: there are no methods to call."""
        raise NotImplementedError("the environments have no methods of their own")


class TimedPPO(PPO):
    """PPO that measures how long collecting and learning take, in s."""

    collecting = learning = 0.0

    def collect_rollouts(self, *args, **kwargs):
        """Collect rollouts as PPO does, and add the seconds to `collecting`."""
        began = time.perf_counter()
        goes_on = super().collect_rollouts(*args, **kwargs)
        self.collecting += time.perf_counter() - began
        return goes_on

    def train(self):
        """Learn from the rollouts as PPO does, and add the seconds to `learning`."""
        began = time.perf_counter()
        super().train()
        self.learning += time.perf_counter() - began


def main() -> None:
    """Train with Stable-Baselines3, then by our own loop; print the control steps/s of both."""
    parser = make_parser(__doc__)
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--envs", type=int, default=1024)
    options = parser.parse_args()
    config = sprint.TASK.ppo
    envs = SB3VecEnv(gymnasium.make_vec("quadwalk/Sprint-v0", num_envs=options.envs))
    model = TimedPPO(
        "MlpPolicy",
        envs,
        n_steps=config.unroll,
        batch_size=options.envs * config.unroll // config.minibatches,
        n_epochs=config.epochs,
        gamma=config.discount,
        gae_lambda=config.gae_lambda,
        policy_kwargs={"net_arch": list(config.hidden)},
        device="cpu",
        seed=0,
    )
    model.learn(options.envs * config.unroll)  # compiles
    envs.seconds = model.collecting = model.learning = 0.0
    before = model.num_timesteps
    model.learn(options.steps, reset_num_timesteps=False)
    steps = model.num_timesteps - before
    seconds = model.collecting + model.learning
    our_training = TimedTraining(options.envs).run(seconds / 4)

    print(f"{'control steps/s':18}{'Stable-Baselines3':>20}{'ours':>12}")
    print(f"{'environments':18}{steps / envs.seconds:20,.0f}")
    print(f"{'policy and buffer':18}{steps / (model.collecting - envs.seconds):20,.0f}")
    rows = {
        "collecting, both": (model.collecting, our_training.collecting),
        "learning": (model.learning, our_training.learning),
        "training, all": (seconds, our_training.seconds),
    }
    for name, (baseline_seconds, our_seconds) in rows.items():
        print(
            f"{name:18}{steps / baseline_seconds:20,.0f}{our_training.steps / our_seconds:12,.0f}"
        )


if __name__ == "__main__":
    main()
