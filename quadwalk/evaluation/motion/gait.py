"""How well and in what manner it ran: figures of one episode, each with its definition.

World frame: z up, x ahead. Heights are above the ground straight below. What cannot be measured
(the stride of a foot that never lands) is NaN.
"""

from dataclasses import dataclass, fields

import mujoco
import numpy as np

from quadwalk.evaluation.motion.course import (
    LEAST_DISTANCE,
    SETTLING,
    action_rate,
    heading_velocity,
    measure_course,
    motor_limits,
    weight_of,
)
from quadwalk.evaluation.motion.footfalls import (
    Footfalls,
    analyze_footfalls,
    touchdowns,
    without_chatter,
)
from quadwalk.evaluation.motion.kinematics import foot_poses, roll_pitch_yaw, rotations
from quadwalk.evaluation.rollout import Rollout, finite_part
from quadwalk.evaluation.statistics import number
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import heights_under


@dataclass(frozen=True)
class Gait:
    """The figures of one episode. Feet are FR, FL, RR, RL; joints in the quadruped's order."""

    fell: bool
    end: str  # how it ended, as in the rollout
    # as in `Course`, up to the end or the first state that is not finite
    duration: float  # s
    distance: float  # m
    speed: float  # m/s
    lateral_drift: float  # m
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
    cost_of_transport: float  # energy per meter / weight
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
    - Slip: the foot is a sphere, so while it rolls its center moves though nothing slips; taken is
      the point of the sphere that touches the ground.
    - Torques are means over a control step, so their peaks are those of 20 ms, not of an instant.
    """
    rollout = finite_part(rollout)
    course, footfalls = measure_course(rollout), footfalls_of(rollout)
    model = quadruped.make_full_model()
    centers, turns = foot_poses(model, quadruped.feet, rollout.qpos)
    radii = np.array([model.geom(foot).size[0] for foot in quadruped.feet])
    slip, slid = _slips(rollout, centers, turns, radii)
    rpy = roll_pitch_yaw(rollout.qpos[:, 3:7])
    yaw = np.unwrap(rpy[:, 2])
    height = rollout.qpos[:, 2] - heights_under(model, rollout.qpos[:, :2])
    soles = centers[:, :, 2] - radii - heights_under(model, centers[:, :, :2])
    torque = np.abs(rollout.torque) / motor_limits(rollout, quadruped)
    torque = torque if rollout.steps else np.full((1, 12), np.nan)
    rate = np.abs(rollout.qvel[:, 6:]) / quadruped.velocity
    return Gait(
        fell=rollout.fell,
        end=rollout.end,
        duration=course.duration,
        distance=course.distance,
        speed=course.speed,
        lateral_drift=course.lateral_drift,
        heading_drift=float(yaw[-1] - yaw[0]),
        gait=footfalls.gait,
        stride_frequency=footfalls.stride_frequency,
        stride_length=_stride_length(rollout, footfalls.stride_frequency),
        duty_factor=footfalls.duty_factor,
        phase=footfalls.phase,
        regularity=footfalls.regularity,
        swing_height=_swing_heights(rollout, soles),
        slip=slip,
        slip_share=slid / (course.distance if course.distance > LEAST_DISTANCE else np.nan),
        body_height=np.array([height.mean(), height.min(), height.max()]),
        roll_range=float(np.ptp(rpy[:, 0])),
        pitch_range=float(np.ptp(rpy[:, 1])),
        cost_of_transport=course.energy_per_meter / weight_of(rollout, model),
        froude=course.speed**2 / (quadruped.gravity * _hip_height(model, quadruped)),
        torque_mean=torque.mean(axis=0),
        torque_peak=torque.max(axis=0),
        joint_speed_mean=rate.mean(axis=0),
        joint_speed_peak=rate.max(axis=0),
        action_rate=action_rate(rollout),
    )


def gait_metrics(gait: Gait, quadruped: Quadruped) -> dict[str, float | str | bool | None]:
    """`gait` as flat names and plain values for JSON: one per foot or leg joint, NaN as None."""
    labels = {4: quadruped.legs, 12: quadruped.joints, 3: ("mean", "least", "greatest")}
    metrics: dict[str, float | str | bool | None] = {}
    for field in fields(gait):
        value = getattr(gait, field.name)
        if isinstance(value, np.ndarray):
            for label, one in zip(labels[len(value)], value, strict=True):
                metrics[f"{field.name}.{label}"] = number(one)
        else:
            metrics[field.name] = value if isinstance(value, bool | str) else number(value)
    return metrics


def footfalls_of(rollout: Rollout) -> Footfalls:
    """The footfalls of an episode once it has settled."""
    rollout = finite_part(rollout)
    return analyze_footfalls(rollout.contact[_settled(rollout) :], rollout.control_dt)


def middle_strides(rollout: Rollout, count: int, otherwise: float) -> tuple[float, float]:
    """Return where `count` strides about an episode's middle begin and end, in control steps.

    They have the episode's mean stride frequency. Where no foot makes strides, `otherwise` seconds
    take their place.
    """
    frequency = footfalls_of(rollout).stride_frequency
    seconds = count / frequency if frequency > 0 else otherwise
    middle, half = rollout.steps / 2, seconds / rollout.control_dt / 2
    return max(middle - half, 0.0), min(middle + half, float(rollout.steps))


def _settled(rollout: Rollout) -> int:
    """The step from which strides are measured; an episode too short for that is taken whole."""
    settling = round(SETTLING / rollout.control_dt)
    return settling if rollout.steps >= 3 * settling else 0


def _stride_length(rollout: Rollout, frequency: float) -> float:
    """m: horizontal speed, with commands in the frame of the heading, over `frequency` in Hz."""
    if not frequency > 0:
        return np.nan
    velocity = rollout.qvel
    if rollout.command is not None:
        velocity = heading_velocity(rollout.qpos, rollout.control_dt)
    mean = velocity[_settled(rollout) :, :2].mean(axis=0)
    return float(np.linalg.norm(mean) / frequency)


def _hip_height(model: mujoco.MjModel, quadruped: Quadruped) -> float:
    """Mean height of the thigh joints, m, in the home pose."""
    data = mujoco.MjData(model)
    data.qpos = quadruped.home
    mujoco.mj_kinematics(model, data)
    return float(np.mean([data.joint(thigh).xanchor[2] for thigh in quadruped.joints[1::3]]))


def _swing_heights(rollout: Rollout, soles: np.ndarray) -> np.ndarray:
    """(4,) m: the greatest height (T + 1, 4) of each swing between two contacts; their mean."""
    contact = without_chatter(rollout.contact, rollout.control_dt)
    heights = np.full(4, np.nan)
    for k in range(4):
        sole = soles[1:, k]  # contact is known at the ends of steps
        lifts = np.flatnonzero(contact[:-1, k] & ~contact[1:, k]) + 1
        lands = touchdowns(contact[:, k])
        peaks = [sole[a : lands[lands > a][0]].max() for a in lifts if np.any(lands > a)]
        if peaks:
            heights[k] = np.mean(peaks)
    return heights


def _slips(
    rollout: Rollout, centers: np.ndarray, turns: np.ndarray, radii: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(4,) m/s and (4,) m: over the time a foot is on the ground at both ends of a step."""
    slips, slid = np.full(4, np.nan), np.zeros(4)
    for k, radius in enumerate(radii):
        stays = rollout.contact[:-1, k] & rollout.contact[1:, k]
        if not stays.any():
            continue
        turned = rotations(turns[2:, k]) * rotations(turns[1:-1, k]).inv()
        moved = np.diff(centers[1:, k], axis=0) + np.cross(turned.as_rotvec(), [0, 0, -radius])
        moved = np.linalg.norm(moved[stays, :2], axis=1)
        slips[k], slid[k] = moved.mean() / rollout.control_dt, moved.sum()
    return slips, slid
