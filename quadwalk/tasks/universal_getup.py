"""universal_getup: `getup` for any quadruped, learned on bodies that differ between episodes.

It begins with the networks of a `getup` of the AlienGo: `--init getup`.
"""

from dataclasses import replace

from quadwalk.env import rewards
from quadwalk.env.actions import about_standard
from quadwalk.env.observations import BODY
from quadwalk.settings.environment import BodiesConfig
from quadwalk.settings.terms import ActionMap, Reward
from quadwalk.tasks import getup

TASK = replace(
    getup.TASK,
    task="universal_getup",
    steps=30_000_000,
    env=replace(
        getup.TASK.env,
        action=ActionMap(about_standard, {"hip": 0.8, "thigh": 2.0, "calf": 1.2}),
        observation={**getup.TASK.env.observation, **BODY},
        reward={
            **getup.TASK.env.reward,
            "legs_in_trunk": Reward(
                rewards.legs_in_trunk, {"margin": 0.02, "height": 0.1}, scale=-20.0
            ),
        },
        # That of the AlienGo, so that all numbers mean what they mean in `getup`.
        unit_leg=0.5,
        bodies=BodiesConfig(number=512),
    ),
)
