"""`drive` with long strides, high swings and feet that do not slip: a task file.

    python train.py walk --steps 12000000 --seed 1 --name first
    python train.py studies/gait/drive.py --init first --seed 1 --name gait
    python eval.py gait

See studies/history.md for what it reaches.
"""

from dataclasses import replace

from quadwalk.tasks import drive
from quadwalk.terms import Observation, Reward, observations, rewards

_ENV = drive.TASK.env

TASK = replace(
    drive.TASK,
    task="drive_gait",
    steps=60_000_000,
    env=replace(
        _ENV,
        critic={**_ENV.critic, "strides": Observation(observations.strides)},
        reward={
            **_ENV.reward,
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
    ),
)
