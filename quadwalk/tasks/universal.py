"""universal: `drive` for any quadruped, learned on bodies that differ from episode to episode.

It begins with the networks of a `drive` of the AlienGo: `--init RUN`. See studies/history.md.
"""

from dataclasses import replace

from quadwalk.env import rewards
from quadwalk.env.actions import ABOUT_STANDARD
from quadwalk.env.observations import BODY
from quadwalk.settings.environment import BodiesConfig
from quadwalk.settings.terms import Reward
from quadwalk.tasks import drive

TASK = replace(
    drive.TASK,
    task="universal",
    steps=110_000_000,
    env=replace(
        drive.TASK.env,
        action=ABOUT_STANDARD,
        observation={**drive.TASK.env.observation, **BODY},
        reward={
            **drive.TASK.env.reward,
            "approach": Reward(rewards.approach, scale=1.5),
            # Bodies that sway fall more often.
            "yaw_rate_off": Reward(rewards.yaw_rate_off, scale=0.0),
            "momentary_yaw_rate_off": Reward(rewards.momentary_yaw_rate_off, scale=-2.0),
            "fidget": Reward(rewards.fidget, scale=-8.0),
            "crouch": Reward(rewards.crouch, {"slow": 0.8}, scale=-4.0),
            "cost_of_transport": Reward(rewards.cost_of_transport, {"slow": 0.15}, scale=-1.0),
        },
        # That of the AlienGo, so that all numbers mean what they mean in `drive`.
        unit_leg=0.5,
        bodies=BodiesConfig(number=512),
    ),
    # Networks that drive already need less noise: with 0.35 all robots fall at first.
    ppo=replace(drive.TASK.ppo, retry=0.3, init_std=0.15),
)
