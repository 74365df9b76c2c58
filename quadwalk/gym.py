"""The tasks as Gymnasium environments, "quadwalk/Run-v0" and so on, stepped by the fast engine.

    import gymnasium
    import quadwalk.gym  # registers them

    env = gymnasium.make("quadwalk/Run-v0")
    envs = gymnasium.make_vec("quadwalk/Run-v0", num_envs=1024)

Observations are what the policy sees; what the value network sees besides is left out.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise ImportError("quadwalk.gym needs Gymnasium: pip install 'quadwalk[gym]'") from error
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from quadwalk.cores import cpu_cores
from quadwalk.errors import UsageError
from quadwalk.paths import ALIENGO_URDF
from quadwalk.task_files import load_task, task_names
from quadwalk.train.settings import TrainConfig
