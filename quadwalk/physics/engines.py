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
        """Return what the engine steps: the robot that MuJoCo's `model` describes, with `motor`.

        `model` was made from `quadruped`.
        """

    def apply_randomization(self, model: Any, randomization: RobotRandomization) -> Any:
        """Return the engine's model of one robot, changed as `randomization` says."""

    def step(
        self, model: Any, stepping: Stepping, physics: PhysicsState, target: jax.Array
    ) -> tuple[PhysicsState, Effort]:
        """Advance one robot by a control step: a pure function, to be jitted and vmapped.

        `target` are joint angles (12,), rad, or (substeps, 12), one row for each physics step.
        Returns the state after the step, and torque and work of the motors in it.
        """


ENGINES: Mapping[EngineName, Engine] = {"fast": fast, "mjx": mjx, "mujoco": mujoco_c}
