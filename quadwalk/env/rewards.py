"""Reward terms: each a small pure function of one control step, in physical units and bounded.

To add one, write such a function, in a file of your own or here, and name it in a task. One here
needs a name in `quadwalk/settings/registry.py`.
`"drag": Reward(drag, {"height": 0.06}, scale=-0.3)`.
"""

import jax
import jax.numpy as jnp

from quadwalk.env.state import RobotConstants, Step, compute_trot_swing, needs_strides
from quadwalk.physics.rotation import compute_gravity_direction, compute_yaw
from quadwalk.settings.terms import Reward


def forward(robot: RobotConstants, step: Step, *, max_speed: float) -> jax.Array:
    """Speed along world x, m/s, from -1 to `max_speed`."""
    return jnp.clip(step.mean_velocity[0], -1.0, max_speed)


def fall(robot: RobotConstants, step: Step) -> jax.Array:
    """1 in the step that ends an episode by a fall."""
    return step.fell.astype(jnp.float32)


def yaw_error(robot: RobotConstants, step: Step) -> jax.Array:
    """Absolute angle between the heading and world x, rad, up to 1."""
    return jnp.minimum(jnp.abs(compute_yaw(step.qpos[3:7])), 1.0)


def energy(robot: RobotConstants, step: Step) -> jax.Array:
    """Mechanical power over weight, m/s, up to 20: cost of transport times speed."""
    return jnp.minimum(step.power / robot.weight, 20.0)


def cost_of_transport(robot: RobotConstants, step: Step, *, slow: float) -> jax.Array:
    """Mechanical power over weight and commanded pace, up to 10; `slow`, m/s, is added to the pace.

    Unlike `energy` it counts as much at a walk as at a gallop.
    """
    pace = _compute_pace(robot, step)
    return jnp.minimum(step.power / (robot.weight * (pace + slow)), 10.0)


def _compute_pace(robot: RobotConstants, step: Step) -> jax.Array:
    """Return the speed () that the command asks of the feet, m/s: ahead, aside and in a turn."""
    return jnp.linalg.norm(step.command[:2]) + robot.home_height * jnp.abs(step.command[2])


def alive(robot: RobotConstants, step: Step) -> jax.Array:
    """1 in every step that does not end in a fall."""
    return 1.0 - step.fell.astype(jnp.float32)


def lateral(robot: RobotConstants, step: Step) -> jax.Array:
    """Speed along world y, m/s, up to 1."""
    return jnp.minimum(jnp.abs(step.mean_velocity[1]), 1.0)


def offset(robot: RobotConstants, step: Step) -> jax.Array:
    """Distance from the line y = 0, m, up to 1."""
    return jnp.minimum(jnp.abs(step.qpos[1]), 1.0)


def vertical(robot: RobotConstants, step: Step) -> jax.Array:
    """Squared vertical speed of the trunk, (m/s)^2, up to 1."""
    return jnp.minimum(jnp.square(step.qvel[2]), 1.0)


def tilt(robot: RobotConstants, step: Step) -> jax.Array:
    """Squared sine of the angle between the trunk's and the world's z axis."""
    return jnp.sum(jnp.square(compute_gravity_direction(step.qpos[3:7])[:2]))


def roll_pitch_rate(robot: RobotConstants, step: Step) -> jax.Array:
    """Roll and pitch rate of the trunk, rad/s, up to 4."""
    return jnp.minimum(jnp.linalg.norm(step.qvel[3:5] + 1e-8), 4.0)


def action_rate(robot: RobotConstants, step: Step) -> jax.Array:
    """Mean squared change of the action since the last step."""
    return jnp.mean(jnp.square(step.action - step.last_action))


def joint_speed(robot: RobotConstants, step: Step) -> jax.Array:
    """Mean squared joint velocity, (rad/s)^2, up to 100."""
    return jnp.minimum(jnp.mean(jnp.square(step.qvel[6:])), 100.0)


def upright(robot: RobotConstants, step: Step) -> jax.Array:
    """1 upright, a quarter on the side, 0 upside down."""
    return jnp.square((1.0 + _compute_up(step)) / 2.0)


def raised(robot: RobotConstants, step: Step) -> jax.Array:
    """Height of the trunk as a share of that of the home pose, up to 1, times `upright`."""
    share = jnp.clip(step.height / robot.home_height, 0.0, 1.0)
    return share * upright(robot, step)


def at_home(robot: RobotConstants, step: Step, *, joints: float, height: float) -> jax.Array:
    """1 upright in the home pose, by 1/e less each for joints and trunk that are off it.

    For joints that are `joints`, rad, off in the root mean square, for a trunk that is `height`, a
    share of the home height, off. Times the cosine of the tilt, 0 from 90 degrees on.
    """
    off = jnp.mean(jnp.square(step.qpos[7:] - robot.home_joints)) / joints**2
    low = jnp.square((step.height / robot.home_height - 1.0) / height)
    return jnp.maximum(_compute_up(step), 0.0) * jnp.exp(-off - low)


def crossed(robot: RobotConstants, step: Step, *, margin: float) -> jax.Array:
    """Distance by which the legs of a pair cross, m, on the mean of both pairs, up to 0.3.

    More than 0 where a knee or foot of the right one is not `margin`, m, to the right of both of
    the left one, in the trunk's frame. Training lets legs pass through each other.
    """
    aside = robot.compute_leg_points(step.qpos[7:])[:, :, 1]
    gap = jnp.min(aside[:, 1::2], axis=0) - jnp.max(aside[:, ::2], axis=0)
    return jnp.mean(jnp.clip(margin - gap, 0.0, 0.3))


def legs_in_trunk(robot: RobotConstants, step: Step, *, margin: float, height: float) -> jax.Array:
    """Distance by which legs reach into the trunk, m, mean of the legs, up to 0.3.

    More than 0 where a knee or foot is nearer the middle of the trunk than at home by more than
    `margin`, m. All of it counts at the level of the trunk's origin, none at `height`, m, below.
    Training lets legs pass through the trunk.
    """
    points = robot.compute_leg_points(step.qpos[7:])
    home = robot.compute_leg_points(robot.home_joints)[..., 1]
    inward = jnp.clip(jnp.abs(home) - margin - jnp.sign(home) * points[..., 1], 0.0, 0.3)
    level = jnp.clip(1.0 + points[..., 2] / height, 0.0, 1.0)
    return jnp.mean(jnp.max(inward * level, axis=0))


def _compute_up(step: Step) -> jax.Array:
    """Return the cosine of the angle between the trunk's and the world's z axis."""
    return -compute_gravity_direction(step.qpos[3:7])[2]


def follow(robot: RobotConstants, step: Step, *, width: float) -> jax.Array:
    """1 at the commanded velocity of the trunk, 1/e at `width`, m/s, off."""
    return jnp.exp(-jnp.sum(jnp.square(step.velocity_error / width)))


def follow_yaw_rate(robot: RobotConstants, step: Step, *, width: float) -> jax.Array:
    """1 at the commanded yaw rate, 1/e at `width`, rad/s, off."""
    return jnp.exp(-jnp.square(step.yaw_rate_error / width))


def track(robot: RobotConstants, step: Step, *, width: float, share: float) -> jax.Array:
    """1 at the commanded velocity, 1/e at `width`, m/s, and `share` of the command off."""
    width = width + share * jnp.linalg.norm(step.command[:2])
    return jnp.exp(-jnp.sum(jnp.square(step.velocity_error / width)))


def approach(robot: RobotConstants, step: Step) -> jax.Array:
    """Commanded speed minus the size of the velocity's error, m/s, from -1 to 5.

    Far from a command, where `track` is flat, this still tells which way is better.
    """
    return jnp.clip(step.commanded_speed, -1.0, 5.0)


@needs_strides
def yaw_rate_off(robot: RobotConstants, step: Step) -> jax.Array:
    """Distance of the yaw rate from its command, rad/s, up to 2, in the mean of a stride.

    The trunk may sway within a stride.
    """
    assert step.strides is not None
    return jnp.minimum(jnp.abs(step.strides.yaw_rate_error), 2.0)


def momentary_yaw_rate_off(robot: RobotConstants, step: Step) -> jax.Array:
    """Distance of the yaw rate from its command, rad/s, up to 2, in each control step.

    Unlike `yaw_rate_off` it counts the sway within a stride.
    """
    return jnp.minimum(jnp.abs(step.yaw_rate_error), 2.0)


def fidget(robot: RobotConstants, step: Step) -> jax.Array:
    """At the command to stand, joints off the home pose, motion and lifted feet, up to 1; else 0.

    It is the mean squared distance, rad^2, plus 0.01 times the mean squared velocity, (rad/s)^2,
    plus 0.1 times the share of the feet that are off the floor.
    """
    off = jnp.mean(jnp.square(step.qpos[7:] - robot.home_joints))
    off += 0.01 * jnp.mean(jnp.square(step.qvel[6:]))
    off += 0.1 * jnp.mean(~step.contact)
    return jnp.minimum(off, 1.0) * jnp.all(step.command == 0.0)


def drag(robot: RobotConstants, step: Step, *, height: float) -> jax.Array:
    """Mean horizontal speed of the soles, m/s, up to 2, each by how low it is.

    On the floor all of a sole's speed counts, at `height`, m, and above none of it.
    """
    speed = _compute_sole_speeds(step)
    low = jnp.clip(1.0 - step.soles[:, 2] / height, 0.0, 1.0)
    return jnp.mean(speed * low)


def _compute_sole_speeds(step: Step) -> jax.Array:
    """Return the mean horizontal speed of each sole over the step (4,), m/s, up to 2."""
    moved = step.soles[:, :2] - step.start_soles[:, :2]
    return jnp.minimum(jnp.linalg.norm(moved, axis=1) / step.dt, 2.0)


def slip(robot: RobotConstants, step: Step) -> jax.Array:
    """Mean horizontal speed of the soles that stay on the floor, m/s, up to 2."""
    speed = _compute_sole_speeds(step)
    return jnp.mean(speed * (step.start_contact & step.contact))


def slip_share(robot: RobotConstants, step: Step, *, slow: float) -> jax.Array:
    """Mean horizontal speed of the soles that stay on the floor over commanded pace, up to 1.

    `slow`, m/s, is added to the pace. Unlike `slip` it makes a foot that shuffles at a slow walk as
    dear as one that slips at a gallop. At the command to stand it is 0.
    """
    pace = _compute_pace(robot, step)
    return jnp.minimum(slip(robot, step) / (pace + slow), 1.0) * (pace > 0.0)


@needs_strides
def short_stride(
    robot: RobotConstants, step: Step, *, frequency: float, increase: float
) -> jax.Array:
    """Number of feet that touch down, each by how much too soon it does, from 0 to 1.

    1 at once after its last touch-down, 0 after 1/f s or more. f is `frequency` times
    sqrt(g / home height) at a stand, and more by `increase` for each unit of the command's Froude
    speed: robots of all sizes step as often by the measure of their legs. A turn on the spot counts
    as the speed of the feet.
    """
    assert step.strides is not None
    rate = frequency + increase * _compute_pace(robot, step) / robot.froude_speed
    rate *= robot.froude_speed / robot.home_height
    soon = jnp.clip(1.0 - rate * (step.strides.time + step.dt), 0.0, 1.0)
    return jnp.sum(soon * step.landed)


@needs_strides
def swing_error(robot: RobotConstants, step: Step, *, low: float, high: float) -> jax.Array:
    """Number of feet that touch down, each by how far its swing was too low or high, from 0 to 1.

    `low` and `high` are shares of the home height. 0 for a sole whose highest point was between
    them, 1 for one that stayed at the floor or rose to twice `high`; linear between.
    """
    assert step.strides is not None
    peak = step.strides.peak / robot.home_height
    off = jnp.maximum(1.0 - peak / low, peak / high - 1.0)
    return jnp.sum(jnp.clip(off, 0.0, 1.0) * step.landed)


def flight(robot: RobotConstants, step: Step, *, slow: float) -> jax.Array:
    """1 with no foot on the floor at the command to stand, 0 from a commanded pace of `slow` on.

    Linear between; `slow` is a share of the Froude speed.
    """
    return _compute_slowness(robot, step, slow) * ~jnp.any(step.contact)


def crouch(robot: RobotConstants, step: Step, *, slow: float) -> jax.Array:
    """Share of the home height that the trunk is too low by, at the command to stand.

    Less for faster commands, 0 from a commanded pace of `slow`, a share of the Froude speed, on.
    """
    low = jnp.clip(1.0 - step.height / robot.home_height, 0.0, 1.0)
    return low * _compute_slowness(robot, step, slow)


def feet_behind(robot: RobotConstants, step: Step) -> jax.Array:
    """Distance of the feet behind their home places, as a share of the home height.

    Along the trunk, of the middle of each pair, mean of both. So the swings of a trot are free, and
    legs that work far behind their hips are not. Ahead is free: there feet brake.
    """
    feet = robot.compute_leg_points(step.qpos[7:])[0, :, 0]
    home = robot.compute_leg_points(robot.home_joints)[0, :, 0]
    behind = jnp.mean((home - feet).reshape(2, 2), axis=1) / robot.home_height
    return jnp.mean(jnp.maximum(behind, 0.0))


def _compute_slowness(robot: RobotConstants, step: Step, slow: float) -> jax.Array:
    """Return 1 at the command to stand, 0 from `slow` Froude speeds on; linear between."""
    return jnp.clip(1.0 - _compute_pace(robot, step) / (slow * robot.froude_speed), 0.0, 1.0)


def kneel(robot: RobotConstants, step: Step, *, height: float) -> jax.Array:
    """1 with a knee or shin on the ground, 0 with all at `height`, m, or more; linear between."""
    return jnp.clip(1.0 - step.lowest[1] / height, 0.0, 1.0)


def trot(
    robot: RobotConstants, step: Step, *, stride: float, height: float, width: float
) -> jax.Array:
    """1 with all soles at the heights of a trot in time, 1/e for a sole `width`, m, off its own.

    Diagonal pairs swing in turn, up to `height`, m, or higher, as a stair asks for, one `stride`
    (control steps) after the other; the policy sees the time by `observation.trot_clock`. At the
    command to stand still all four belong on the floor.
    """
    swing = compute_trot_swing(step.steps, step.command, stride)[jnp.array([0, 1, 1, 0])]
    soles = step.soles[:, 2]
    off = jnp.where(swing > 0.0, jnp.maximum(height * swing - soles, 0.0), soles)
    return jnp.mean(jnp.exp(-jnp.square(off / width)))


def diagonal(robot: RobotConstants, step: Step, *, height: float) -> jax.Array:
    """Height of one diagonal pair of soles above the other, 1 at `height`, m, or more.

    In a trot each pair is above the other in turn. In a bound, a pace and a pronk it is 0: both
    feet ahead, all on one side, or all four move together.
    """
    front, back = jnp.split(step.soles[:, 2], 2)
    apart = jnp.mean(jnp.array([front[0] - front[1], back[1] - back[0]]))
    return jnp.minimum(jnp.abs(apart) / height, 1.0)


def compute_reward_terms(
    terms: dict[str, Reward], robot: RobotConstants, step: Step
) -> dict[str, jax.Array]:
    """Return the value () of every term before its scale; those with scale 0 are left out."""
    return {
        name: term.compute(f"reward {name!r}", robot, step)
        for name, term in terms.items()
        if term.in_use
    }


def compute_total_reward(terms: dict[str, Reward], values: dict[str, jax.Array]) -> jax.Array:
    """Return the sum of the terms' values times their scales."""
    return sum((terms[name].scale * value for name, value in values.items()), jnp.zeros(()))
