"""rough: follow a velocity command over slopes, stairs, rubble and ditches, seeing the terrain."""

from dataclasses import replace

from quadwalk.env import rewards
from quadwalk.env.actions import about_home
from quadwalk.env.observations import (
    PROPRIOCEPTION,
    TROT_COMMAND,
    TRUE_LEGS,
    TRUE_TRUNK,
    height_scan,
)
from quadwalk.env.terminations import TRUNK_FALLS
from quadwalk.settings.environment import HOME_RESET, PHYSICS, REAL_WORLD, CommandConfig, EnvConfig
from quadwalk.settings.terms import ActionMap, Observation, Reward
from quadwalk.settings.training import PPO_UNEVEN, TrainConfig
from quadwalk.terrain.terrain import FLAT

# m; legged_gym's is 1.6 x 1 m, and its noise as large.
SCAN = {"length": 1.2, "width": 0.6, "spacing": 0.1, "reach": 0.5}

TASK = TrainConfig(
    task="rough",
    suite="terrain",
    steps=52_000_000,
    checkpoint_steps=2_000_000,
    env=EnvConfig(
        **{**PHYSICS, "contacts": "knees"},  # the trunk's touch is the end
        action=ActionMap(about_home, {"hip": 0.5, "thigh": 0.9, "calf": 1.1}),
        observation={
            **TROT_COMMAND,
            **PROPRIOCEPTION,
            "height_scan": Observation(height_scan, SCAN, noise=0.05),
        },
        critic={**TRUE_TRUNK, **TRUE_LEGS},
        reward={
            "fall": Reward(rewards.fall, scale=-10.0),
            "energy": Reward(rewards.energy, scale=-0.2),
            "vertical": Reward(rewards.vertical, scale=-0.5),
            "tilt": Reward(rewards.tilt, scale=-0.1),
            "roll_pitch_rate": Reward(rewards.roll_pitch_rate, scale=-0.05),
            "action_rate": Reward(rewards.action_rate, scale=-0.1),
            # Knees may touch, so without this it crawls. Where it stands, shins are 2 cm up.
            "kneel": Reward(rewards.kneel, {"height": 0.015}, scale=-1.0),
            "follow": Reward(rewards.follow, {"width": 0.35}, scale=1.0),
            "follow_yaw_rate": Reward(rewards.follow_yaw_rate, {"width": 0.35}, scale=0.5),
            "drag": Reward(rewards.drag, {"height": 0.02}, scale=-0.3),
            "trot": Reward(rewards.trot, {"stride": 20.0, "height": 0.1, "width": 0.04}, scale=1.0),
        },
        termination=TRUNK_FALLS,
        reset=replace(HOME_RESET, yaw=3.14, offset=0.0),
        command=CommandConfig(
            forward=(-0.5, 1.2),
            lateral=(-0.3, 0.3),
            yaw_rate=(-0.7, 0.7),
            standing=0.05,
            seconds=5.0,
            straight=0.5,  # else few get to the edge of their tiles, and levels rise slowly
        ),
        randomization=replace(
            REAL_WORLD, trunk_mass=(-0.1, 0.25), push=(0.0, 0.5), push_seconds=5.0, margin=0.0
        ),
        ground=replace(
            FLAT,
            kinds=(
                "flat",
                *("slope_up",) * 2,  # the hardest have more of the robots
                *("slope_down",) * 2,
                "rough",
                "waves",
                *("stairs_up",) * 3,
                *("stairs_down",) * 3,
                "blocks",
                "ditches",
            ),
            levels=6,  # few and far apart: 52 million steps are only 26 full episodes of each robot
            curriculum=True,
            confined=True,  # so that levels follow soon, and each robot meets its own
        ),
    ),
    ppo=PPO_UNEVEN,
)
