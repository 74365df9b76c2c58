"""Stable-Baselines3's PPO on our environments through Gymnasium, and where its time goes.

    pip install -e '.[sb3]'
    python benchmarks/gymnasium_ppo.py [--steps 300000]

It trains on `gymnasium.make_vec("quadwalk/Sprint-v0")` with the networks and batch sizes of ours.
Stepping the environments, the rest of collecting (its policy, its buffer) and learning are timed
apart, and set beside what `python train.py sprint` does of the same on the same cores.
The adapter below is all that Stable-Baselines3 needs.
"""

import argparse
import time

import gymnasium
import numpy as np
from default_training import DefaultTraining
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

import quadwalk.gym  # noqa: F401 - registers the environments
from quadwalk.tasks import sprint

ENVS = 1024


class SB3VecEnv(VecEnv):
    """A Gymnasium vector environment that resets in the same step, as SB3's own kind."""

    def __init__(self, envs: gymnasium.vector.VectorEnv) -> None:
        self.envs, self.seconds = envs, 0.0
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self):
        seen, _ = self.envs.reset(seed=self._seeds[0])
        return seen

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        began = time.perf_counter()
        seen, reward, terminated, truncated, infos = self.envs.step(self.actions)
        self.seconds += time.perf_counter() - began
        done = terminated | truncated
        told = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            told[i] = {
                "terminal_observation": infos["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i]),
            }
        return seen, reward, done, told

    def close(self):
        self.envs.close()

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs

    def get_attr(self, attr_name, indices=None):
        return [getattr(self.envs, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError("the environments have no attributes of their own")

    def env_method(self, method_name, *args, indices=None, **kwargs):
        raise NotImplementedError("the environments have no methods of their own")


class TimedPPO(PPO):
    """PPO that says how long collecting and learning took."""

    collecting = learning = 0.0

    def collect_rollouts(self, *args, **kwargs):
        began = time.perf_counter()
        going_on = super().collect_rollouts(*args, **kwargs)
        self.collecting += time.perf_counter() - began
        return going_on

    def train(self):
        began = time.perf_counter()
        super().train()
        self.learning += time.perf_counter() - began


def train_sb3(steps: int) -> dict[str, float]:
    """Seconds that each part takes for a control step, over `steps` of them once compiled."""
    ours = sprint.TASK.ppo
    envs = SB3VecEnv(gymnasium.make_vec("quadwalk/Sprint-v0", num_envs=ENVS))
    model = TimedPPO(
        "MlpPolicy",
        envs,
        n_steps=ours.unroll,
        batch_size=ENVS * ours.unroll // ours.minibatches,
        n_epochs=ours.epochs,
        gamma=ours.discount,
        gae_lambda=ours.gae_lambda,
        policy_kwargs={"net_arch": list(ours.hidden)},
        device="cpu",
        seed=0,
    )
    model.learn(ENVS * ours.unroll)  # compiles
    envs.seconds = model.collecting = model.learning = 0.0
    before = model.num_timesteps
    model.learn(steps, reset_num_timesteps=False)
    done = model.num_timesteps - before
    return {
        "environments": envs.seconds / done,
        "policy and buffer": (model.collecting - envs.seconds) / done,
        "collecting, both": model.collecting / done,
        "learning": model.learning / done,
        "training, all": (model.collecting + model.learning) / done,
    }


def train_ours(seconds: float) -> dict[str, float]:
    """The same of ours, which collects in one program; in some `seconds`."""
    collecting, learning = DefaultTraining(ENVS).run_parts(seconds)
    parts = collecting.seconds / collecting.steps, learning.seconds / learning.steps
    return {"collecting, both": parts[0], "learning": parts[1], "training, all": sum(parts)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=300_000)
    options = parser.parse_args()
    theirs = train_sb3(options.steps)
    ours = train_ours(options.steps * theirs["training, all"] / 4)
    print(f"{'control steps/s':18}{'Stable-Baselines3':>20}{'ours':>12}")
    for name, seconds in theirs.items():
        own = f"{1 / ours[name]:12,.0f}" if name in ours else ""
        print(f"{name:18}{1 / seconds:20,.0f}{own}")


if __name__ == "__main__":
    main()
