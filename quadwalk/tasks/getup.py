"""getup: stand up from any pose on the ground, on its back too, and stand still."""

from dataclasses import replace

from quadwalk.env import rewards
from quadwalk.env.actions import feet_alike
from quadwalk.env.observations import PROPRIOCEPTION, TRUE_LEGS, TRUE_TRUNK
from quadwalk.settings.environment import HOME_RESET, NO_COMMAND, PHYSICS, REAL_WORLD, EnvConfig
from quadwalk.settings.terms import ActionMap, Reward
from quadwalk.settings.training import PPO, TrainConfig

TASK = TrainConfig(
    task="getup",
    suite="standing",
    steps=40_000_000,
    checkpoint_steps=2_000_000,
    env=EnvConfig(
        **{**PHYSICS, "contacts": "all", "episode_seconds": 6.0},
        action=ActionMap(feet_alike, {"hip": 0.8, "thigh": 2.0, "calf": 1.2}),
        observation=PROPRIOCEPTION,
        critic={**TRUE_TRUNK, **TRUE_LEGS},
        reward={
            "upright": Reward(rewards.upright, scale=1.0),
            "raised": Reward(rewards.raised, scale=1.0),
            "at_home": Reward(rewards.at_home, {"joints": 0.3, "height": 0.35}, scale=2.0),
            "crossed": Reward(rewards.crossed, {"margin": 0.05}, scale=-20.0),
            "energy": Reward(rewards.energy, scale=-0.05),
            "action_rate": Reward(rewards.action_rate, scale=-0.05),
            "joint_speed": Reward(rewards.joint_speed, scale=-0.002),
        },
        termination={},  # it lies at the start
        reset=replace(HOME_RESET, joints=0.8, tumbled=True),
        command=NO_COMMAND,
        randomization=REAL_WORLD,
    ),
    # Noise frees a robot that pushes with all its torque and does not move.
    ppo=replace(PPO, discount=0.98, stochastic=True),
)
