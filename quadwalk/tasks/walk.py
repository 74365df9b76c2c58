"""walk: follow a velocity command at a trot, with a real robot's sensors and disturbances."""

from quadwalk.env import rewards
from quadwalk.env.actions import ABOUT_HOME
from quadwalk.env.observations import PROPRIOCEPTION, TROT_COMMAND, TRUE_LEGS, TRUE_TRUNK
from quadwalk.env.terminations import FALLS
from quadwalk.settings.environment import HOME_RESET, PHYSICS, REAL_WORLD, CommandConfig, EnvConfig
from quadwalk.settings.terms import Reward
from quadwalk.settings.training import PPO, TrainConfig

TASK = TrainConfig(
    task="walk",
    suite="course",
    steps=24_000_000,
    checkpoint_steps=2_000_000,
    env=EnvConfig(
        **PHYSICS,
        action=ABOUT_HOME,
        observation={**TROT_COMMAND, **PROPRIOCEPTION},
        critic={**TRUE_TRUNK, **TRUE_LEGS},
        reward={
            "fall": Reward(rewards.fall, scale=-30.0),
            "energy": Reward(rewards.energy, scale=-0.2),
            "vertical": Reward(rewards.vertical, scale=-0.5),
            "tilt": Reward(rewards.tilt, scale=-8.0),
            "roll_pitch_rate": Reward(rewards.roll_pitch_rate, scale=-0.05),
            "action_rate": Reward(rewards.action_rate, scale=-0.1),
            "follow": Reward(rewards.follow, {"width": 0.35}, scale=1.0),
            "follow_yaw_rate": Reward(rewards.follow_yaw_rate, {"width": 0.35}, scale=0.5),
            "drag": Reward(rewards.drag, {"height": 0.02}, scale=-0.3),
            "feet_behind": Reward(rewards.feet_behind, scale=-2.0),
            "trot": Reward(
                rewards.trot, {"stride": 20.0, "height": 0.08, "width": 0.04}, scale=1.0
            ),
        },
        termination=FALLS,
        reset=HOME_RESET,
        command=CommandConfig(
            forward=(-0.5, 1.5),
            lateral=(-0.5, 0.5),
            yaw_rate=(-1.0, 1.0),
            standing=0.1,
            seconds=5.0,
        ),
        randomization=REAL_WORLD,
    ),
    ppo=PPO,
)
