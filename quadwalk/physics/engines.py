"""The engines: three ways to step a robot, behind one interface.

An engine is a module with `make_model`, which reads a MuJoCo model into a pytree of constants, and
`step`, a pure function of it to be jitted and vmapped.
"""

from collections.abc import Mapping
from typing import Any, Literal, Protocol

import jax
import mujoco

from quadwalk.physics import fast, mjx, mujoco_c
from quadwalk.physics.model import RobotRandomization
from quadwalk.physics.motor import Effort, Motor, PhysicsState, Stepping
from quadwalk.robot.quadruped import Quadruped

EngineName = Literal["fast", "mjx", "mujoco"]


class Engine(Protocol):
    """What each engine's module has. A model has a leaf `motor`, the `Motor`."""

    def make_model(self, model: mujoco.MjModel, quadruped: Quadruped, motor: Motor) -> Any:
        """The constants of the robot that `model`, made from `quadruped`, describes."""

    def apply_randomization(self, model: Any, variation: RobotRandomization) -> Any:
        """The constants of one robot that differs by `variation` from that of `model`."""

    def step(
        self, model: Any, stepping: Stepping, physics: PhysicsState, target: jax.Array
    ) -> tuple[PhysicsState, Effort]:
        """One control step; `target` (12,) or (substeps, 12), rad, one for each physics step."""


ENGINES: Mapping[EngineName, Engine] = {"fast": fast, "mjx": mjx, "mujoco": mujoco_c}
