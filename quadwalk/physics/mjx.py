"""The engine MJX: MuJoCo's own physics in JAX, of any model; slower, to evaluate and check with.

The state carried is what physics needs and no more. An `mjx.Data` holds some hundred arrays, most
of them results: XLA drops every one that nothing reads, and a reset is a copy of three arrays.
"""

import contextlib
import copy
import io
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco

from quadwalk.physics import motor
from quadwalk.physics.model import RobotRandomization, randomize_motor
from quadwalk.physics.motor import Effort, Motor, PhysicsState, Stepping
from quadwalk.robot.quadruped import Quadruped

with contextlib.redirect_stdout(io.StringIO()):  # it prints that an optional back end is missing
    from mujoco import mjx

# MJX's solver settings, at least: with fewer, robots brake too little on slippery floors.
ITERATIONS = 5
LINE_SEARCH = 5  # evaluations in each iteration


class MjxModel(NamedTuple):
    """A robot's constants; under `jax.vmap`, any leaf may differ from robot to robot."""

    mjx: mjx.Model
    motor: Motor


def make_model(model: mujoco.MjModel, quadruped: Quadruped, motor: Motor) -> MjxModel:
    """Return the engine's model, on this process's first device."""
    model = copy.copy(model)
    model.opt.iterations = max(ITERATIONS, model.opt.iterations)
    model.opt.ls_iterations = max(LINE_SEARCH, model.opt.ls_iterations)
    # By default MJX takes the first of all devices, which may be another process's.
    return MjxModel(mjx.put_model(model, device=jax.local_devices()[0]), motor)


def apply_randomization(model: MjxModel, randomization: RobotRandomization) -> MjxModel:
    """Return the model of one robot, changed as `randomization` says; see `Engine`."""
    old = model.mjx
    trunk, legs = old.jnt_bodyid[0], old.jnt_bodyid[1:]
    factor = randomization.link_mass
    new = old.replace(
        geom_friction=old.geom_friction.at[:, 0].set(randomization.friction),
        body_mass=old.body_mass.at[trunk].add(randomization.trunk_mass).at[legs].multiply(factor),
        body_ipos=old.body_ipos.at[trunk].add(randomization.trunk_center),
        body_inertia=old.body_inertia.at[legs].multiply(factor[:, None]),
        dof_armature=old.dof_armature.at[6:].multiply(randomization.armature),
        dof_damping=old.dof_damping.at[6:].multiply(randomization.damping),
    )
    return MjxModel(new, randomize_motor(model.motor, randomization))


def step(
    model: MjxModel, stepping: Stepping, physics: PhysicsState, target: jax.Array
) -> tuple[PhysicsState, Effort]:
    """Advance one robot by a control step; see `Engine`."""
    physics, target = jax.tree.map(jnp.asarray, (physics, target))
    blank = mjx.make_data(model.mjx)

    def advance(state: PhysicsState, torque: jax.Array) -> PhysicsState:
        data = blank.replace(
            qpos=state.qpos,
            qvel=state.qvel,
            # Not by the actuators, for these have limits of their own.
            qfrc_applied=blank.qfrc_applied.at[6:].set(torque),
        )
        data = mjx.step(model.mjx, data)
        return PhysicsState(data.qpos, data.qvel)

    return motor.run_control_step(model.motor, stepping, physics, target, advance)
