"""Observations: parts of what the policy observes, each a pure function of the state.

To add one, write such a function, in a file of your own or here, and name it in a task. One here
needs a name in `quadwalk/settings/registry.py`.
`"heading": Observation(heading, noise=0.05)`.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.constants import Description
from quadwalk.env.reflections import (
    AXIAL,
    FEET,
    JOINTS,
    LATERAL,
    LINKS,
    SCALAR,
    VECTOR,
    Mirror,
    make_grid_mirror,
    mirrors,
)
from quadwalk.env.state import (
    EnvState,
    RobotConstants,
    compute_height,
    compute_trot_swing,
    needs_strides,
)
from quadwalk.physics.rotation import (
    compute_gravity_direction,
    compute_yaw,
    rotate_inverse,
)
from quadwalk.settings.environment import COMMANDED
from quadwalk.settings.terms import Observation


@mirrors(VECTOR)
def velocity(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Linear velocity of the trunk (3,), body frame, m/s."""
    return rotate_inverse(state.qpos[3:7], state.qvel[:3])


@mirrors(AXIAL)
def angular_velocity(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Angular velocity of the trunk (3,), body frame, rad/s."""
    return state.qvel[3:6]


@mirrors(VECTOR)
def gravity(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Direction of gravity (3,), body frame, a unit vector."""
    return compute_gravity_direction(state.qpos[3:7])


@mirrors(LATERAL)
def heading(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Angle of the trunk's x axis from world x about world z, rad."""
    return compute_yaw(state.qpos[3:7])


@mirrors(LATERAL)
def offset(robot: RobotConstants, state: EnvState, *, reach: float) -> jax.Array:
    """Distance to the left of the line y = 0, m, as far as `reach`."""
    return jnp.clip(state.qpos[1], -reach, reach)


@mirrors(SCALAR, LATERAL, LATERAL)
def command(robot: RobotConstants, state: EnvState) -> jax.Array:
    """The velocity command (3,): forward and lateral m/s, yaw rate rad/s."""
    return state.velocity_command


# In the mirror a trot is half a stride away.
@mirrors(LATERAL, LATERAL)
def trot_clock(robot: RobotConstants, state: EnvState, *, stride: float) -> jax.Array:
    """Sine and cosine (2,) of a trot's phase, for `reward.trot`; 0 at the command to stand still.

    `stride` is in control steps.
    """
    swing = partial(compute_trot_swing, command=state.velocity_command, stride=stride)
    return jnp.stack([swing(state.steps)[0], swing(state.steps + stride / 4)[0]])


@mirrors(JOINTS)
def joint_positions(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Joint angles (12,) from the home pose, rad."""
    return state.qpos[7:] - robot.home_joints


@mirrors(JOINTS)
def joint_velocities(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Joint velocities (12,), rad/s."""
    return state.qvel[6:]


@mirrors(JOINTS)
def last_action(robot: RobotConstants, state: EnvState) -> jax.Array:
    """The action of the last step (12,), in [-1, 1]."""
    return state.last_action


@mirrors(SCALAR)
def height(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Height of the trunk's origin above the ground, m."""
    return compute_height(robot, state.qpos)


@mirrors(
    lambda robot, params: _make_scan_mirror(params["length"], params["width"], params["spacing"])
)
def height_scan(
    robot: RobotConstants,
    state: EnvState,
    *,
    length: float,
    width: float,
    spacing: float,
    reach: float,
) -> jax.Array:
    """Distance of the ground below where it is in the home pose, m (n,), -`reach` to `reach`.

    The points are `spacing` m apart in a rectangle about the trunk's origin, turned with its
    heading: rows from behind to ahead, in each from the right to the left.
    """
    ahead, left = _make_coordinates(length, spacing), _make_coordinates(width, spacing)
    return _scan_ground(robot, state, ahead, left, reach)


@mirrors(
    lambda robot, params: _make_scan_mirror(
        params["last"] - params["first"], params["width"], params["spacing"]
    ),
)
def scan_ahead(
    robot: RobotConstants,
    state: EnvState,
    *,
    first: float,
    last: float,
    width: float,
    spacing: float,
    reach: float,
) -> jax.Array:
    """`height_scan` (n,) from `first` to `last`, m ahead of the trunk's origin; < 0 is behind."""
    ahead = (first + last) / 2 + _make_coordinates(last - first, spacing)
    return _scan_ground(robot, state, ahead, _make_coordinates(width, spacing), reach)


def _make_coordinates(side: float, spacing: float) -> np.ndarray:
    """Return evenly spaced coordinates (n,) about 0 on a side of that length, m."""
    gaps = round(side / spacing)
    return spacing * (np.arange(gaps + 1) - gaps / 2)


def _make_scan_mirror(length: float, width: float, spacing: float) -> Mirror:
    return make_grid_mirror(
        _make_coordinates(length, spacing).size, _make_coordinates(width, spacing).size
    )


def _scan_ground(
    robot: RobotConstants, state: EnvState, ahead: np.ndarray, left: np.ndarray, reach: float
) -> jax.Array:
    """Return the scan at all of `ahead` (k,) times `left` (l,), m: (k * l,)."""
    x, y = (axis.ravel() for axis in np.meshgrid(ahead, left, indexing="ij"))
    heading = compute_yaw(state.qpos[3:7])
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    level: jax.typing.ArrayLike = np.zeros(ahead.size * left.size)
    if robot.ground is not None:
        # In this order of additions the policies were trained.
        places = (state.qpos[0] + cos * x - sin * y, state.qpos[1] + sin * x + cos * y)
        level = robot.ground.measure(*places)[0]
    return jnp.clip(state.qpos[2] - robot.home_height - level, -reach, reach)


@mirrors(FEET)
def contacts(robot: RobotConstants, state: EnvState) -> jax.Array:
    """1 for each foot (4,) on the floor, else 0; for the value network only."""
    assert state.contact is not None
    return state.contact.astype(jnp.float32)


@needs_strides
@mirrors(FEET, FEET)
def strides(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Time since each foot's touch-down, s, up to 1, and its highest sole since, m (8,).

    For the value network only.
    """
    assert state.strides is not None
    return jnp.concatenate([jnp.minimum(state.strides.time, 1.0), state.strides.peak])


@needs_strides
@mirrors(LATERAL)
def mean_yaw_rate_error(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Yaw rate minus its command, rad/s, in the mean of a stride; for the value network only."""
    assert state.strides is not None
    return state.strides.yaw_rate_error


@mirrors(*(SCALAR,) * len(Description._fields))
def body(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Description of the robot's body (n,), without units: see `quadwalk/env/constants.py`."""
    return jnp.asarray(robot.description, jnp.float32)


@mirrors(
    *(SCALAR, SCALAR, VECTOR, LINKS),
    *(SCALAR,) * 8,  # six factors and two delays
    *(SCALAR,) * 3,  # sizes of pushes, without their signs, and of noise
    JOINTS,
)
def conditions(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Randomization of the episode (n,), empty in an ideal world; for the value network only.

    Friction, added mass kg, shift of its center m (3,), factors of links (12,) and motors, latency
    in physics and control steps, pushes m/s (2,), noise, encoder offsets rad (12,).
    """
    values = state.conditions
    if values is None:
        return jnp.zeros(0)
    late = jnp.zeros(()) if values.sensor_delay is None else values.sensor_delay
    parts = *(values.variation or ()), values.delay, late, values.push, values.noise, values.encoder
    return jnp.concatenate([jnp.atleast_1d(jnp.asarray(x, jnp.float32)) for x in parts])


# Measurements of a robot's IMU and encoders, and its own last action.
PROPRIOCEPTION = {
    "angular_velocity": Observation(angular_velocity, noise=0.2, history=4),
    "gravity": Observation(gravity, noise=0.05, history=4),
    "joint_pos": Observation(joint_positions, noise=0.01, history=4),
    "joint_vel": Observation(joint_velocities, noise=1.5, history=4),
    "last_action": Observation(last_action, history=4),
}
BODY = {"body": Observation(body, labels=Description._fields)}
HEADING = {"heading": Observation(heading, noise=0.05)}
COMMAND = {"command": Observation(command, labels=COMMANDED)}
# A velocity command, to be followed at a trot.
TROT_COMMAND = {
    **COMMAND,
    "clock": Observation(trot_clock, {"stride": 20.0}, labels=("sine", "cosine")),
}
# Known in simulation alone, for the value network: of the trunk, and of the legs.
TRUE_TRUNK = {
    "velocity": Observation(velocity),
    "angular_velocity": Observation(angular_velocity),
    "gravity": Observation(gravity),
    "height": Observation(height),
}
TRUE_LEGS = {
    "joint_pos": Observation(joint_positions),
    "joint_vel": Observation(joint_velocities),
    "contacts": Observation(contacts),
    "conditions": Observation(conditions),
}


def compute_observation(
    parts: dict[str, Observation], robot: RobotConstants, state: EnvState
) -> jax.Array:
    """Return the observation (n,), float32: its parts one after another."""
    values = [part.compute(f"observation {name!r}", robot, state) for name, part in parts.items()]
    return jnp.concatenate([jnp.atleast_1d(value) for value in values])
