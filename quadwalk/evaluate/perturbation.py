"""A control step under perturbations that the policy was not asked about.

The step is put together from the environment's own functions: observation, motors, physics,
termination and reward are those of training. Without perturbation it computes what
`QuadrupedEnv.step_in_mjx` does.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State

from quadwalk.evaluate.simulate import Policy
from quadwalk.physics.mjx_engine import Effort, Physics, simulate
from quadwalk.physics.model import Legged
from quadwalk.physics.motor import gains, joint_target
from quadwalk.physics.quiet_mjx import mjx
from quadwalk.physics.robot_arrays import RobotArrays
from quadwalk.robot.quadruped import Quadruped
from quadwalk.task.config import EnvConfig
from quadwalk.task.env import EnvState, conclude

PUSH_PERIOD = 5.0  # s: one push in each

# Standard deviation of the sensor noise at level 1, of the observations whose names begin so. The
# numbers are those of legged_gym (Rudin et al., "Learning to walk in minutes", CoRL 2021), where
# they bound uniform noise; what it has not, heading, offset, and the world's position and
# orientation (a quaternion's parts change by half an angle), are an IMU's and a camera's guess.
NOISE = {
    "world_position_": 0.05,  # m
    "world_orientation_": 0.025,
    "world_velocity_": 0.1,  # m/s
    "world_angular_velocity_": 0.2,  # rad/s
    "velocity_": 0.1,  # m/s
    "angular_velocity_": 0.2,  # rad/s
    "gravity_": 0.05,
    "heading": 0.05,  # rad
    "offset": 0.05,  # m
    "position_": 0.01,  # rad
    "speed_": 1.5,  # rad/s
    "last_action_": 0.0,  # known exactly
    "command_": 0.0,
}


class Perturbation(NamedTuple):
    """What one episode suffers, beside a changed model; scalars, or batched arrays of them.

    - strength: every torque of the joint controller is this many times what it would be, and so is
      its limit: the motors' torque constant differs from what the controller believes.
    - delay: a joint target is obeyed this many physics steps after the observation that it is the
      answer to; until the first is, the home pose is held.
    - push: m/s, by which the trunk's velocity along world y, sideways to the run, changes in an
      instant, once in every `PUSH_PERIOD`, at a time and to a side that the episode's seed draws.
    - noise: level of the Gaussian noise, independent in every step and number, that is added to
      what the policy sees; `NOISE` is level 1.
    """

    strength: Any
    delay: Any
    push: Any
    noise: Any


class Perturbed(NamedTuple):
    """What an episode carries from step to step."""

    state: State
    targets: jax.Array  # (n, 12) joint targets, the newest first
    key: jax.Array  # of the episode's noise and pushes


def history(delay: int, substeps: int) -> int:
    """How many joint targets, the newest included, a delay of so many physics steps needs."""
    return 1 + -(-delay // substeps)


def noise_scale(names: tuple[str, ...]) -> np.ndarray:
    """`NOISE` of each observation (n,), by its name."""
    return np.array([next(std for part, std in NOISE.items() if n.startswith(part)) for n in names])


def begin(robot: RobotArrays, state: State, key: jax.Array, kept: int) -> Perturbed:
    """The start of an episode that keeps `kept` joint targets."""
    return Perturbed(state, jnp.tile(jnp.asarray(robot.home_joints, jnp.float32), (kept, 1)), key)


def perturbed_step(
    model: mjx.Model,
    legged: Legged,
    robot: RobotArrays,
    config: EnvConfig,
    noise: np.ndarray,
    policy: Policy,
    perturbation: Perturbation,
    episode: Perturbed,
) -> Perturbed:
    """One control step of `policy`, in MJX; `noise` is `noise_scale` of the observations."""
    before: EnvState = episode.state.pipeline_state
    sensors, pushes = jax.random.split(episode.key)
    seen = sensed(episode.state.obs, perturbation.noise * noise, sensors, before.steps)
    action = policy(seen)
    target = joint_target(robot, config.actuation, action, before.physics.qpos[7:])
    targets = jnp.concatenate([target[None], episode.targets[:-1]])

    kick = perturbation.push * side_of_push(pushes, before.steps, config.control_dt)
    physics = before.physics._replace(qvel=before.physics.qvel.at[1].add(kick))
    physics, effort = _delayed(model, robot, config, perturbation, physics, targets)
    state = conclude(legged, robot, config, before, action, physics, effort)
    return Perturbed(state, targets, episode.key)


def sensed(obs: jax.Array, std: jax.Array, key: jax.Array, step: jax.Array) -> jax.Array:
    """`obs` (n,) with Gaussian noise of `std` (n,), the same for the same key and step."""
    return obs + std * jax.random.normal(jax.random.fold_in(key, step), obs.shape)


def side_of_push(key: jax.Array, step: jax.Array, control_dt: float) -> jax.Array:
    """1 or -1 in the control step of a push to the left or right, else 0."""
    period = max(round(PUSH_PERIOD / control_dt), 1)
    when, side = jax.random.split(jax.random.fold_in(key, step // period))
    now = step % period == jax.random.randint(when, (), 0, period)
    return jnp.where(now, jax.random.rademacher(side, (), jnp.float32), 0.0)


def _delayed(
    model: mjx.Model,
    robot: RobotArrays,
    config: EnvConfig,
    perturbation: Perturbation,
    physics: Physics,
    targets: jax.Array,
) -> tuple[Physics, Effort]:
    """The control step's physics steps one by one, each with the target that it obeys."""
    kp, kd = gains(robot, config.actuation)
    strength = perturbation.strength
    actuation = dataclasses.replace(config.actuation, kp=kp * strength, kd=kd * strength)
    robot = dataclasses.replace(robot, effort=robot.effort * strength)
    single = dataclasses.replace(config, substeps=1, actuation=actuation)

    def substep(
        carry: tuple[Physics, Effort], number: jax.Array
    ) -> tuple[tuple[Physics, Effort], None]:
        physics, total = carry
        # Of how many control steps ago: those begun within the last `delay` physics steps.
        ago = jnp.maximum(perturbation.delay - number + config.substeps - 1, 0) // config.substeps
        physics, effort = simulate(model, robot, single, physics, targets[ago])
        torque = total.torque + effort.torque / config.substeps
        return (physics, Effort(torque, total.energy + effort.energy)), None

    start = (physics, Effort(jnp.zeros(12), jnp.zeros(())))
    (physics, effort), _ = jax.lax.scan(substep, start, jnp.arange(config.substeps))
    return physics, effort


def varied_quadruped(
    quadruped: Quadruped, friction: float | None = None, added_mass: float = 0.0
) -> Quadruped:
    """The robot on another floor, carrying a load.

    `friction` is the sliding friction between feet and floor; None leaves it. (MuJoCo takes the
    greater of the two geoms', so both get it.) `added_mass`, kg, is a point mass in the trunk's
    centre of mass, which leaves that point and the inertia about it as they are; the compiler
    derives subtree masses, inverse weights and mean inertia anew.
    """
    spec = quadruped.spec.copy()
    if friction is not None:
        for name in ("floor", *quadruped.feet):
            spec.geom(name).friction[0] = friction
    spec.body(quadruped.trunk).mass += added_mass
    return dataclasses.replace(quadruped, spec=spec)


def stack_models(models: Sequence[mjx.Model]) -> tuple[list[Any], list[int | None]]:
    """The arrays of models of one structure, and along which axis `vmap` maps each.

    Those that differ are stacked, with the models along axis 0; the others are as in the first,
    with None for an axis. `jax.tree.unflatten` makes a model of them again.
    """
    stacked: list[Any] = []
    axes: list[int | None] = []
    for leaves in zip(*map(jax.tree.leaves, models), strict=True):
        # On the host: MJX ties its arrays to one device, and the episodes are on all of them.
        arrays = [np.asarray(leaf) for leaf in leaves]
        same = all(np.array_equal(arrays[0], array) for array in arrays[1:])
        stacked.append(arrays[0] if same else np.stack(arrays))
        axes.append(None if same else 0)
    return stacked, axes
