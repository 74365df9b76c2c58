"""universal: `drive` for any quadruped, learned on bodies that differ from episode to episode."""

from dataclasses import replace

from quadwalk.env.actions import ABOUT_STANDARD
from quadwalk.env.observations import BODY
from quadwalk.settings.environment import BodiesConfig
from quadwalk.tasks import drive

TASK = replace(
    drive.TASK,
    task="universal",
    env=replace(
        drive.TASK.env,
        action=ABOUT_STANDARD,
        observation={**drive.TASK.env.observation, **BODY},
        # That of the AlienGo, so that all numbers mean what they mean in `drive`.
        unit_leg=0.5,
        bodies=BodiesConfig(number=256),
    ),
    # A fall's conditions are of the body that fell.
    ppo=replace(drive.TASK.ppo, retry=0.0),
)
