"""universal: `drive` for any quadruped, learned on bodies that differ from episode to episode.

It begins with the networks of a `drive` of the AlienGo: `--init RUN`. See studies/history.md.
"""

from dataclasses import replace

from quadwalk.env import rewards
from quadwalk.env.actions import ABOUT_STANDARD
from quadwalk.env.observations import BODY, strides
from quadwalk.settings.environment import BodiesConfig
from quadwalk.settings.terms import Observation, Reward
from quadwalk.tasks import drive

TASK = replace(
    drive.TASK,
    task="universal",
    steps=60_000_000,
    env=replace(
        drive.TASK.env,
        action=ABOUT_STANDARD,
        observation={**drive.TASK.env.observation, **BODY},
        critic={**drive.TASK.env.critic, "strides": Observation(strides)},
        # For long strides and high swings.
        reward={
            **drive.TASK.env.reward,
            "energy": Reward(rewards.energy, scale=-0.1),
            "cost_of_transport": Reward(rewards.cost_of_transport, {"slow": 0.3}, scale=-0.8),
            "vertical": Reward(rewards.vertical, scale=-0.5),
            "short_stride": Reward(
                rewards.short_stride, {"frequency": 0.45, "increase": 0.21}, scale=-4.0
            ),
            "swing_error": Reward(rewards.swing_error, {"low": 0.16, "high": 0.3}, scale=-2.0),
            "flight": Reward(rewards.flight, {"slow": 0.8}, scale=-1.0),
            "drag": Reward(rewards.drag, {"height": 0.06}, scale=-0.5),
            "slip": Reward(rewards.slip, scale=-1.0),
        },
        # That of the AlienGo, so that all numbers mean what they mean in `drive`.
        unit_leg=0.5,
        bodies=BodiesConfig(number=512),
    ),
    # A fall's conditions are of the body that fell.
    ppo=replace(drive.TASK.ppo, retry=0.0),
)
