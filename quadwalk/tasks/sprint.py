"""sprint: run along world x as fast as possible, without noise or delay (easier)."""

from dataclasses import replace

from quadwalk.env import observations, rewards
from quadwalk.env.actions import ABOUT_HOME
from quadwalk.env.observations import HEADING
from quadwalk.env.terminations import FALLS
from quadwalk.settings.environment import (
    HOME_RESET,
    NO_COMMAND,
    NO_RANDOMIZATION,
    PHYSICS,
    EnvConfig,
)
from quadwalk.settings.terms import Observation, Reward
from quadwalk.settings.training import PPO, TrainConfig

TASK = TrainConfig(
    task="sprint",
    suite="course",
    steps=21_000_000,
    checkpoint_steps=2_000_000,
    env=EnvConfig(
        **PHYSICS,
        action=ABOUT_HOME,
        observation={
            "velocity": Observation(observations.velocity, noise=0.1),
            "angular_velocity": Observation(observations.angular_velocity, noise=0.2),
            "gravity": Observation(observations.gravity, noise=0.05),
            **HEADING,
            "offset": Observation(observations.offset, {"reach": 1.0}, noise=0.05),
            "joint_pos": Observation(observations.joint_positions, noise=0.01),
            "joint_vel": Observation(observations.joint_velocities, noise=1.5),
            "last_action": Observation(observations.last_action),
        },
        critic={},
        reward={
            "forward": Reward(rewards.forward, {"max_speed": 7.0}, scale=1.0),
            "fall": Reward(rewards.fall, scale=-10.0),
            "yaw": Reward(rewards.yaw_error, scale=-0.6),
            "energy": Reward(rewards.energy, scale=-0.02),
            "alive": Reward(rewards.alive, scale=0.5),
            "lateral": Reward(rewards.lateral, scale=-0.3),
            "offset": Reward(rewards.offset, scale=-0.3),
            "vertical": Reward(rewards.vertical, scale=-0.3),
            "tilt": Reward(rewards.tilt, scale=-0.5),
            "roll_pitch_rate": Reward(rewards.roll_pitch_rate, scale=-0.1),
            "action_rate": Reward(rewards.action_rate, scale=-0.1),
        },
        termination=FALLS,
        reset=HOME_RESET,
        command=NO_COMMAND,
        randomization=NO_RANDOMIZATION,
    ),
    ppo=replace(PPO, entropy=0.01),
)
