"""The engines: three ways to step a robot, behind one interface."""

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
    """The functions that each engine's module has.

    A model is a pytree of one robot's constants, with a leaf `motor`, the `Motor`.
    """

    def make_model(self, model: mujoco.MjModel, quadruped: Quadruped, motor: Motor) -> Any:
        """Return the engine's model of the robot that `model`, made from `quadruped`, describes."""

    def apply_randomization(self, model: Any, randomization: RobotRandomization) -> Any:
        """Return the model of one robot with other physical properties."""

    def step(
        self, model: Any, stepping: Stepping, physics: PhysicsState, target: jax.Array
    ) -> tuple[PhysicsState, Effort]:
        """Advance one robot by a control step: a pure function, to be jitted and vmapped.

        `target` is (12,), rad, or (substeps, 12), one for each physics step.
        """


ENGINES: Mapping[EngineName, Engine] = {"fast": fast, "mjx": mjx, "mujoco": mujoco_c}
