"""Physics steps in MJX: of any model, and an opinion on those of `legged_physics`.

The state carried is what physics needs and no more. An `mjx.Data` holds some hundred arrays, most
of them results: XLA drops every one that nothing reads, and a reset is a copy of three arrays.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from quadwalk.physics.motor import friction_torque, motor_torque
from quadwalk.physics.quiet_mjx import mjx
from quadwalk.physics.robot_arrays import RobotArrays


class Physics(NamedTuple):
    """The state of one robot."""

    qpos: jax.Array  # (19,)
    qvel: jax.Array  # (18,)
    warmstart: jax.Array  # (18,) acceleration that the contact solver starts from


class Effort(NamedTuple):
    """What the motors did in a control step."""

    torque: jax.Array  # (12,) Nm, mean
    energy: jax.Array  # () J, positive mechanical work: none is given back to the battery


def control_step(
    robot: RobotArrays,
    config: Any,
    physics: Physics,
    target: jax.Array,
    advance: Callable[[Physics, jax.Array, jax.Array], Physics],
) -> tuple[Physics, Effort]:
    """`substeps` physics steps with the joint controller run in each, whichever engine steps.

    `target` (12,) rad; `advance` steps a state with the joints' motor torques and friction (12,),
    Nm. All arrays may have further axes behind, if the robot's are columns.
    """

    def substep(carry: tuple[Physics, Effort], _: None) -> tuple[tuple[Physics, Effort], None]:
        state, effort = carry
        q, qd = state.qpos[7:], state.qvel[6:]
        torque = motor_torque(robot, config.motor, target, q, qd)
        friction = friction_torque(robot, config.motor, qd)
        work = jnp.sum(jnp.maximum(torque * qd, 0.0), axis=0) * config.physics_dt
        effort = Effort(effort.torque + torque / config.substeps, effort.energy + work)
        return (advance(state, torque, friction), effort), None

    nothing = jnp.zeros_like(physics.qpos[7:])
    start = (physics, Effort(nothing, nothing[0]))
    return jax.lax.scan(substep, start, None, length=config.substeps)[0]


def simulate(
    model: mjx.Model, robot: RobotArrays, config: Any, physics: Physics, target: jax.Array
) -> tuple[Physics, Effort]:
    """One control step in MJX."""
    blank = mjx.make_data(model)

    def advance(state: Physics, torque: jax.Array, friction: jax.Array) -> Physics:
        data = blank.replace(
            qpos=state.qpos,
            qvel=state.qvel,
            qacc_warmstart=state.warmstart,
            ctrl=torque,
            qfrc_applied=blank.qfrc_applied.at[6:].set(friction),
        )
        data = mjx.step(model, data)
        return Physics(data.qpos, data.qvel, data.qacc_warmstart)

    return control_step(robot, config, physics, target, advance)
