"""`drive` with long strides, high swings and feet that do not slip: a task file.

    python train.py walk --steps 12000000 --seed 1 --name first
    python train.py studies/gait/drive.py --init first --seed 1 --name gait
    python eval.py gait

See studies/history.md for what it reaches.
"""

from dataclasses import replace

from quadwalk.tasks import drive, universal

TASK = replace(
    drive.TASK,
    task="drive_gait",
    steps=60_000_000,
    # The rewards of `universal`, which has learned to drive with them.
    env=replace(drive.TASK.env, critic=universal.TASK.env.critic, reward=universal.TASK.env.reward),
)
