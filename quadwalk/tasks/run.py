"""run: run along world x as fast as possible, with a real robot's sensors and disturbances."""

from dataclasses import replace

from quadwalk.env import rewards
from quadwalk.env.actions import ABOUT_HOME
from quadwalk.env.observations import HEADING, PROPRIOCEPTION, TRUE_LEGS, TRUE_TRUNK, heading
from quadwalk.env.terminations import FALLS
from quadwalk.settings.environment import HOME_RESET, NO_COMMAND, PHYSICS, REAL_WORLD, EnvConfig
from quadwalk.settings.terms import Observation, Reward
from quadwalk.settings.training import PPO, TrainConfig

TASK = TrainConfig(
    task="run",
    suite="course",
    steps=33_000_000,
    checkpoint_steps=2_000_000,
    env=EnvConfig(
        **PHYSICS,
        action=ABOUT_HOME,
        observation={**HEADING, **PROPRIOCEPTION},
        critic={**TRUE_TRUNK, "heading": Observation(heading), **TRUE_LEGS},
        reward={
            "forward": Reward(rewards.forward, {"max_speed": 7.0}, scale=1.0),
            "fall": Reward(rewards.fall, scale=-30.0),
            "yaw": Reward(rewards.yaw_error, scale=-0.6),
            "energy": Reward(rewards.energy, scale=-0.02),
            "alive": Reward(rewards.alive, scale=0.5),
            # Of the gaits that are found by chance in the first minute the trot is the fastest.
            "diagonal": Reward(rewards.diagonal, {"height": 0.04}, scale=0.4),
            "lateral": Reward(rewards.lateral, scale=-0.3),
            "vertical": Reward(rewards.vertical, scale=-0.3),
            "tilt": Reward(rewards.tilt, scale=-0.5),
            "roll_pitch_rate": Reward(rewards.roll_pitch_rate, scale=-0.1),
            "action_rate": Reward(rewards.action_rate, scale=-0.1),
        },
        termination=FALLS,
        reset=HOME_RESET,
        command=NO_COMMAND,
        randomization=REAL_WORLD,
    ),
    ppo=replace(PPO, retry=0.5),
)
