"""How well and in what manner it ran: figures of one episode, each with its definition.

World frame: z up, x ahead, the floor at z = 0. An episode with commands goes where it is told, so
that its distance is that along its path. What cannot be measured (the stride of a foot that
never lands) is NaN.
"""

from dataclasses import dataclass, fields

import numpy as np

from quadwalk.evaluate import kinematics
from quadwalk.evaluate.footfalls import Footfalls, analyse_footfalls, without_chatter
from quadwalk.evaluate.rollout import Rollout
from quadwalk.evaluate.tracking import heading_velocity, path_length
from quadwalk.evaluate.trim import finite_part
from quadwalk.robot.quadruped import Quadruped

SETTLING = 1.0  # s left out of the footfalls and strides, while it gets going
LEAST_DISTANCE = 0.1  # m: under this a cost per metre means nothing


@dataclass(frozen=True)
class Gait:
    """The figures of one episode. Feet are FR, FL, RR, RL; joints in the quadruped's order."""

    fell: bool
    end: str  # how it ended, as in the rollout
    duration: float  # s, up to the end or the first state that is not finite
    distance: float  # m, displacement along world x; with commands, length of the path
    speed: float  # m/s, distance / duration
    lateral_drift: float  # m, displacement along world y
    heading_drift: float  # rad, change of yaw, whole turns included
    gait: str  # walk, trot, pace, bound, gallop, pronk or irregular
    stride_frequency: float  # Hz
    stride_length: float  # m, horizontal speed / stride frequency, once settled
    duty_factor: np.ndarray  # (4,) fraction of its strides that a foot is on the ground
    phase: np.ndarray  # (4,) of a stride, touchdown after FR's
    regularity: np.ndarray  # (4,) in [0, 1], how alike the phases are from stride to stride
    swing_height: np.ndarray  # (4,) m, mean over swings of the sole's greatest height
    slip: np.ndarray  # (4,) m/s, mean horizontal speed of the point that touches the ground
    slip_share: np.ndarray  # (4,) how far that point slides on the ground, of the distance
    body_height: np.ndarray  # (3,) m, mean, least, greatest height of the base's origin
    roll_range: float  # rad, greatest less least roll
    pitch_range: float  # rad, the same for pitch
    cost_of_transport: float  # energy / (weight * distance)
    froude: float  # speed^2 / (g * hip height)
    torque_mean: np.ndarray  # (12,) mean of |torque| / effort limit
    torque_peak: np.ndarray  # (12,) greatest |torque| / effort limit
    joint_speed_mean: np.ndarray  # (12,) mean of |joint velocity| / velocity limit
    joint_speed_peak: np.ndarray  # (12,) greatest |joint velocity| / velocity limit
    action_rate: float  # 1/s, root mean square rate of the actions, which are in [-1, 1]


def measure_gait(rollout: Rollout, quadruped: Quadruped) -> Gait:
    """All figures of `Gait` for one episode.

    - Cost of transport: positive mechanical work over weight times distance (Tucker, "The
      energetic cost of moving about", American Scientist 63, 1975), without the motors' heat.
    - Froude number: speed squared over g times the hip's standing height (Alexander & Jayes, "A
      dynamic similarity hypothesis for the gaits of quadrupedal mammals", J. Zoology 201, 1983);
      animals change from walking to trotting near 0.5, to galloping near 2 to 3.
    - Slip: the foot is a sphere, so while it rolls its centre moves though nothing slips; taken is
      the point of the sphere that touches the ground.
    - Torques are means over a control step, so their peaks are those of 20 ms, not of an instant.
    """
    rollout = finite_part(rollout)
    tree = kinematics.read_tree(quadruped.urdf, quadruped.joints)
    poses = kinematics.world_poses(tree, rollout.qpos)
    duration = rollout.steps * rollout.control_dt
    dx, dy = (rollout.qpos[-1, :2] - rollout.qpos[0, :2]).astype(float)
    distance = dx if rollout.command is None else path_length(rollout)
    rpy = kinematics.rpy_from_quat(kinematics.quat_normalised(rollout.qpos[:, 3:7]))
    yaw = np.unwrap(rpy[:, 2])
    speed = _ratio(distance, duration)
    settled = _settled(rollout)
    feet = analyse_footfalls(rollout.contact[settled:], rollout.control_dt)
    cruise = _cruise(rollout, settled) if duration else np.nan
    home = kinematics.world_poses(tree, quadruped.home[None])
    hip_height = float(np.mean([home[thigh][0][0, 2] for thigh in tree.thighs]))
    centres = kinematics.foot_positions(tree, poses)
    weight = tree.mass * quadruped.gravity
    energy = float(np.sum(rollout.energy))
    slip, slid = _slips(rollout, tree, poses, centres)
    changes = np.diff(rollout.action.astype(float), axis=0) / rollout.control_dt
    height = rollout.qpos[:, 2]
    torque = np.abs(rollout.torque) / quadruped.effort
    rate = np.abs(rollout.qvel[:, 6:]) / quadruped.velocity
    return Gait(
        fell=rollout.fell,
        end=rollout.end,
        duration=duration,
        distance=float(distance),
        speed=speed,
        lateral_drift=float(dy),
        heading_drift=float(yaw[-1] - yaw[0]) if len(yaw) else 0.0,
        gait=feet.gait,
        stride_frequency=feet.stride_frequency,
        stride_length=_ratio(cruise, feet.stride_frequency),
        duty_factor=feet.duty_factor,
        phase=feet.phase,
        regularity=feet.regularity,
        swing_height=_swing_heights(rollout, tree, centres),
        slip=slip,
        slip_share=slid / distance if distance > LEAST_DISTANCE else np.full(4, np.nan),
        body_height=np.array([height.mean(), height.min(), height.max()])
        if len(height)
        else np.full(3, np.nan),
        roll_range=_spread(rpy[:, 0]),
        pitch_range=_spread(rpy[:, 1]),
        cost_of_transport=energy / (weight * distance) if distance > LEAST_DISTANCE else np.nan,
        froude=speed**2 / (quadruped.gravity * hip_height),
        torque_mean=_over_rows(np.mean, torque),
        torque_peak=_over_rows(np.max, torque),
        joint_speed_mean=_over_rows(np.mean, rate),
        joint_speed_peak=_over_rows(np.max, rate),
        action_rate=float(np.sqrt(np.mean(np.square(changes)))) if len(changes) else np.nan,
    )


def gait_metrics(gait: Gait, quadruped: Quadruped) -> dict[str, float | str | bool | None]:
    """`gait` as flat names and plain values for JSON: one per foot or leg joint, NaN as None."""
    labels = {4: quadruped.legs, 12: quadruped.joints, 3: ("mean", "least", "greatest")}
    metrics: dict[str, float | str | bool | None] = {}
    for field in fields(gait):
        value = getattr(gait, field.name)
        if isinstance(value, np.ndarray):
            for label, number in zip(labels[len(value)], value, strict=True):
                metrics[f"{field.name}.{label}"] = _plain(number)
        else:
            metrics[field.name] = value if isinstance(value, bool | str) else _plain(value)
    return metrics


def footfalls_of(rollout: Rollout) -> Footfalls:
    """The footfalls of an episode once it has settled."""
    rollout = finite_part(rollout)
    return analyse_footfalls(rollout.contact[_settled(rollout) :], rollout.control_dt)


def _settled(rollout: Rollout) -> int:
    """The step from which strides are measured; an episode too short for that is taken whole."""
    settling = round(SETTLING / rollout.control_dt)
    return settling if rollout.steps >= 3 * settling else 0


def _cruise(rollout: Rollout, settled: int) -> float:
    """Horizontal speed once settled, m/s; with commands, which may turn it, in its own frame."""
    velocity = rollout.qvel[:, :2] if rollout.command is None else heading_velocity(rollout)[:, :2]
    return float(np.linalg.norm(velocity[settled:].mean(axis=0)))


def _swing_heights(rollout: Rollout, tree: kinematics.LinkTree, centres: np.ndarray) -> np.ndarray:
    """(4,) m: for each swing between two contacts, the sole's greatest height; their mean."""
    contact = without_chatter(rollout.contact, rollout.control_dt)
    heights = np.full(4, np.nan)
    for k, foot in enumerate(tree.feet):
        sole = centres[1:, k, 2] - foot.radius  # contact is known at the ends of steps
        lifts = np.flatnonzero(contact[:-1, k] & ~contact[1:, k]) + 1
        lands = np.flatnonzero(~contact[:-1, k] & contact[1:, k]) + 1
        peaks = [sole[a : lands[lands > a][0]].max() for a in lifts if np.any(lands > a)]
        if peaks:
            heights[k] = np.mean(peaks)
    return heights


def _slips(
    rollout: Rollout,
    tree: kinematics.LinkTree,
    poses: dict[str, tuple[np.ndarray, np.ndarray]],
    centres: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(4,) m/s and (4,) m: over the time a foot is on the ground at both ends of a step."""
    slips, slid = np.full(4, np.nan), np.zeros(4)
    for k, foot in enumerate(tree.feet):
        stays = rollout.contact[:-1, k] & rollout.contact[1:, k]
        if not stays.any():
            continue
        turns = poses[foot.link][1][1:]
        turned = _rotation_vector(
            kinematics.quat_mul(turns[1:], kinematics.quat_conjugate(turns[:-1]))
        )
        moved = np.diff(centres[1:, k], axis=0) + np.cross(turned, [0.0, 0.0, -foot.radius])
        moved = np.linalg.norm(moved[stays, :2], axis=1)
        slips[k], slid[k] = moved.mean() / rollout.control_dt, moved.sum()
    return slips, slid


def _rotation_vector(quat: np.ndarray) -> np.ndarray:
    """(T, 3) axis times angle in rad of (T, 4) unit quaternions, the short way round."""
    quat = np.where(quat[:, :1] < 0, -quat, quat)
    sine = np.linalg.norm(quat[:, 1:], axis=1, keepdims=True)
    angle = 2 * np.arctan2(sine, quat[:, :1])
    return quat[:, 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)


def _over_rows(reduce, array: np.ndarray) -> np.ndarray:
    return reduce(array, axis=0) if len(array) else np.full(array.shape[1], np.nan)


def _spread(values: np.ndarray) -> float:
    return float(values.max() - values.min()) if len(values) else np.nan


def _ratio(a: float, b: float) -> float:
    return float(a / b) if np.isfinite(b) and b > 0 else np.nan


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
