"""Settings of trainings, robots and tasks: the public place to import them from."""

from quadwalk.physics.motor import MotorConfig
from quadwalk.settings.environment import (
    HOME_RESET,
    NO_COMMAND,
    NO_RANDOMIZATION,
    PHYSICS,
    REAL_WORLD,
    CommandConfig,
    EnvConfig,
    RandomizationConfig,
    ResetConfig,
)
from quadwalk.settings.training import (
    PPO,
    PPO_UNEVEN,
    DistributedConfig,
    PPOConfig,
    RobotConfig,
    TrainConfig,
)
from quadwalk.terrain.terrain import FLAT, GroundConfig

__all__ = [
    "FLAT",
    "HOME_RESET",
    "NO_COMMAND",
    "NO_RANDOMIZATION",
    "PHYSICS",
    "PPO",
    "PPO_UNEVEN",
    "REAL_WORLD",
    "CommandConfig",
    "DistributedConfig",
    "EnvConfig",
    "GroundConfig",
    "MotorConfig",
    "PPOConfig",
    "RandomizationConfig",
    "ResetConfig",
    "RobotConfig",
    "TrainConfig",
]
