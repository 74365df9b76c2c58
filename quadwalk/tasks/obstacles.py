"""obstacles: run along world x, as fast as is safe, over blocks, logs and ditches."""

from dataclasses import replace

from quadwalk.env import rewards
from quadwalk.env.actions import ABOUT_HOME
from quadwalk.env.observations import (
    HEADING,
    PROPRIOCEPTION,
    TRUE_LEGS,
    TRUE_TRUNK,
    heading,
    scan_ahead,
)
from quadwalk.env.terminations import TRUNK_FALLS
from quadwalk.settings.environment import HOME_RESET, NO_COMMAND, PHYSICS, REAL_WORLD, EnvConfig
from quadwalk.settings.terms import Observation, Reward
from quadwalk.settings.training import PPO_UNEVEN, TrainConfig
from quadwalk.terrain.terrain import FLAT

# m; at 3 m/s what is 1.5 m ahead comes in half a second.
SCAN = {"first": -0.5, "last": 1.5, "width": 0.5, "spacing": 0.125, "reach": 0.5}

TASK = TrainConfig(
    task="obstacles",
    suite="terrain",
    steps=32_000_000,
    checkpoint_steps=2_000_000,
    env=EnvConfig(
        **{**PHYSICS, "contacts": "knees", "episode_seconds": 10.0},  # the trunk's touch ends it
        action=ABOUT_HOME,
        observation={
            **HEADING,
            **PROPRIOCEPTION,
            "height_scan": Observation(scan_ahead, SCAN, noise=0.03),
        },
        critic={**TRUE_TRUNK, "heading": Observation(heading), **TRUE_LEGS},
        reward={
            # Where faster pays, one in eight falls over blocks of 10 cm, whatever a fall costs.
            "forward": Reward(rewards.forward, {"max_speed": 2.75}, scale=1.0),
            "fall": Reward(rewards.fall, scale=-30.0),
            "yaw": Reward(rewards.yaw_error, scale=-0.6),
            "energy": Reward(rewards.energy, scale=-0.02),
            "alive": Reward(rewards.alive, scale=0.5),
            "lateral": Reward(rewards.lateral, scale=-0.3),
            "vertical": Reward(rewards.vertical, scale=-0.1),
            "tilt": Reward(rewards.tilt, scale=-0.2),
            "roll_pitch_rate": Reward(rewards.roll_pitch_rate, scale=-0.1),
            "action_rate": Reward(rewards.action_rate, scale=-0.1),
            # Knees may touch, so without this it crawls. Where it stands, shins are 2 cm up.
            "kneel": Reward(rewards.kneel, {"height": 0.015}, scale=-1.0),
        },
        termination=TRUNK_FALLS,
        reset=replace(HOME_RESET, offset=0.0),
        command=NO_COMMAND,
        randomization=replace(
            REAL_WORLD, trunk_mass=(-0.1, 0.25), push=(0.0, 0.5), push_seconds=5.0, margin=0.0
        ),
        ground=replace(
            FLAT,
            kinds=("course",) * 6,  # each row another
            levels=6,
            tile=(20.0, 5.0),
            border=1.0,
            curriculum=True,
        ),
    ),
    ppo=PPO_UNEVEN,
)
