"""sprint: run along world x as fast as possible, without noise or delay (easier)."""

from dataclasses import replace

from quadwalk.env import observations as observation
from quadwalk.env import rewards as reward
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
            "velocity": Observation(observation.velocity, noise=0.1),
            "angular_velocity": Observation(observation.angular_velocity, noise=0.2),
            "gravity": Observation(observation.gravity, noise=0.05),
            **HEADING,
            "offset": Observation(observation.offset, {"reach": 1.0}, noise=0.05),
            "joint_pos": Observation(observation.joint_positions, noise=0.01),
            "joint_vel": Observation(observation.joint_velocities, noise=1.5),
            "last_action": Observation(observation.last_action),
        },
        critic={},
        reward={
            "forward": Reward(reward.forward, {"max_speed": 7.0}, scale=1.0),
            "fall": Reward(reward.fall, scale=-10.0),
            "yaw": Reward(reward.yaw_error, scale=-0.6),
            "energy": Reward(reward.energy, scale=-0.02),
            "alive": Reward(reward.alive, scale=0.5),
            "lateral": Reward(reward.lateral, scale=-0.3),
            "offset": Reward(reward.offset, scale=-0.3),
            "vertical": Reward(reward.vertical, scale=-0.3),
            "tilt": Reward(reward.tilt, scale=-0.5),
            "roll_pitch_rate": Reward(reward.roll_pitch_rate, scale=-0.1),
            "action_rate": Reward(reward.action_rate, scale=-0.1),
        },
        termination=FALLS,
        reset=HOME_RESET,
        command=NO_COMMAND,
        randomization=NO_RANDOMIZATION,
    ),
    ppo=replace(PPO, entropy=0.01),
)
