"""The reward: named terms, each a small pure function of one control step.

Terms are raw, in physical units, and bounded, but for the blog post's, which are as it has them;
`RewardConfig` holds one scale for each. To add a term, write its function, name it in `TERMS`, and
give `RewardConfig` a field of that name.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from quadwalk.physics.robot_arrays import RobotArrays
from quadwalk.physics.rotation import euler, rotate_inverse, yaw
from quadwalk.task.config import RewardConfig


class Step(NamedTuple):
    """One control step, as the reward sees it."""

    dt: float  # s
    start: jax.Array  # (nq,) qpos before the step
    qpos: jax.Array  # (nq,) after it
    qvel: jax.Array  # (nv,) after it; trunk: world linear m/s, body angular rad/s
    action: jax.Array  # (12,)
    last_action: jax.Array  # (12,)
    power: jax.Array  # () W, mean mechanical power that the motors gave in the step
    fell: jax.Array  # () bool
    command: jax.Array  # (3,) as in `Command`; zero where there is none
    start_soles: jax.Array  # (4, 3) m, the lowest points of the feet before the step
    soles: jax.Array  # (4, 3) after it
    contact: jax.Array  # (4,) bool, feet on the floor after it


def mean_velocity(step: Step) -> jax.Array:
    """Mean velocity (2,) of the trunk over the step along world x and y, m/s."""
    return (step.qpos[:2] - step.start[:2]) / step.dt


def velocity_error(step: Step) -> jax.Array:
    """That in the frame of the heading after the step, forward and left, less the command (2,)."""
    heading = yaw(step.qpos[3:7])
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    x, y = mean_velocity(step)
    return jnp.stack([cos * x + sin * y, cos * y - sin * x]) - step.command[:2]


def commanded_speed(step: Step) -> jax.Array:
    """How much of the commanded speed there is, m/s: its size less that of the error."""
    return jnp.linalg.norm(step.command[:2]) - jnp.linalg.norm(velocity_error(step))


def turning_error(step: Step) -> jax.Array:
    """Mean rate of the heading over the step, less the command, rad/s."""
    turned = yaw(step.qpos[3:7]) - yaw(step.start[3:7])
    turned = jnp.arctan2(jnp.sin(turned), jnp.cos(turned))  # the short way round
    return turned / step.dt - step.command[2]


def forward(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Speed along world x, m/s, up to `max_speed`."""
    return jnp.clip(mean_velocity(step)[0], -1.0, config.max_speed)


def fall(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """1 in the step that ends an episode by a fall."""
    return step.fell.astype(jnp.float32)


def yaw_error(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Angle between the heading and world x, rad, up to 1."""
    return jnp.minimum(jnp.abs(yaw(step.qpos[3:7])), 1.0)


def energy(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Mechanical power over weight, m/s, up to 20: cost of transport times speed."""
    return jnp.minimum(step.power / robot.weight, 20.0)


def alive(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """1 in every step that does not end in a fall."""
    return 1.0 - step.fell.astype(jnp.float32)


def lateral(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Speed along world y, m/s, up to 1."""
    return jnp.minimum(jnp.abs(mean_velocity(step)[1]), 1.0)


def offset(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Distance from the line y = 0, m, up to 1."""
    return jnp.minimum(jnp.abs(step.qpos[1]), 1.0)


def vertical(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Squared vertical speed of the trunk, (m/s)^2, up to 1."""
    return jnp.minimum(jnp.square(step.qvel[2]), 1.0)


def tilt(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Squared sine of the angle between the trunk's and the world's z axis."""
    gravity = rotate_inverse(step.qpos[3:7], jnp.array([0.0, 0.0, -1.0]))
    return jnp.sum(jnp.square(gravity[:2]))


def turning(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Roll and pitch rate of the trunk, rad/s, up to 4."""
    return jnp.minimum(jnp.linalg.norm(step.qvel[3:5] + 1e-8), 4.0)


def action_rate(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Mean squared change of the action since the last step."""
    return jnp.mean(jnp.square(step.action - step.last_action))


def progress(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Distance along world x in the step, m."""
    return step.qpos[0] - step.start[0]


def inclined(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """1 while roll or pitch is beyond 45 degrees."""
    roll_and_pitch = euler(step.qpos[3:7])[:2]
    return (jnp.max(jnp.abs(roll_and_pitch)) > jnp.pi / 4).astype(jnp.float32)


def heading(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Angle between the heading and world x, rad."""
    return jnp.abs(euler(step.qpos[3:7])[2])


def movement(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """How far the joints moved in the step, all together, rad.

    From where the reset put them in an episode's first step. The post's code remembers the joints
    of the last episode's end there: it clears its memory only when it is made.
    """
    return jnp.sum(jnp.abs(step.qpos[7:] - step.start[7:]))


def follow(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """1 where the trunk's velocity is as commanded, and exp(-1) where it is `follow_width` off."""
    return jnp.exp(-jnp.sum(jnp.square(velocity_error(step) / config.follow_width)))


def follow_turning(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """The same for the rate of turning."""
    return jnp.exp(-jnp.square(turning_error(step) / config.follow_width))


def drag(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """Mean horizontal speed of the soles, m/s, up to 2, each by how low it is.

    On the floor all of a sole's speed counts, at `swing_height` and above none of it.
    """
    moved = step.soles[:, :2] - step.start_soles[:, :2]
    speed = jnp.minimum(jnp.linalg.norm(moved, axis=1) / step.dt, 2.0)
    low = jnp.clip(1.0 - step.soles[:, 2] / config.swing_height, 0.0, 1.0)
    return jnp.mean(speed * low)


def trot(robot: RobotArrays, config: RewardConfig, step: Step) -> jax.Array:
    """The share of the two diagonal pairs whose feet are both on the floor, or both off it.

    0 where all four are off it: a trot at ease has a pair on the floor at any time.
    """
    fore, hind = step.contact[:2], step.contact[:1:-1]  # FR and FL, and RL and RR across from them
    return jnp.mean(fore == hind) * jnp.any(step.contact)


TERMS = {
    "forward": forward,
    "fall": fall,
    "yaw": yaw_error,
    "energy": energy,
    "alive": alive,
    "lateral": lateral,
    "offset": offset,
    "vertical": vertical,
    "tilt": tilt,
    "turning": turning,
    "action_rate": action_rate,
    "progress": progress,
    "inclined": inclined,
    "heading": heading,
    "movement": movement,
    "follow": follow,
    "follow_turning": follow_turning,
    "drag": drag,
    "trot": trot,
}


def active_terms(config: RewardConfig) -> tuple[str, ...]:
    """Names of the terms whose scale is not 0."""
    return tuple(name for name in TERMS if getattr(config, name) != 0.0)


def reward_terms(robot: RobotArrays, config: RewardConfig, step: Step) -> dict[str, jax.Array]:
    """The raw value of every active term, each a scalar."""
    return {name: TERMS[name](robot, config, step) for name in active_terms(config)}


def total_reward(config: RewardConfig, terms: dict[str, jax.Array]) -> jax.Array:
    """The scaled sum of the terms."""
    return sum((getattr(config, name) * value for name, value in terms.items()), jnp.zeros(()))
