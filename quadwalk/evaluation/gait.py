"""The gait of an episode: strides, duty factors and phases, and how well the robot ran.

A stride of a foot goes from one touchdown to its next. The phase of another foot is the fraction of
the reference foot's stride after which it touches down. See Hildebrand, "Symmetrical gaits of
horses", Science 150, 1965. The gait's name follows from the phases (the same; Hildebrand,
"Analysis of asymmetrical gaits", J. Mammalogy 58, 1977; Alexander, "The gaits of bipedal and
quadrupedal animals", Int. J. Robotics Research 3, 1984).

World frame: z up, x ahead. Heights are above the ground straight below. What cannot be measured
(the stride of a foot that never lands) is NaN.
"""

import itertools
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from quadwalk.evaluation.metrics import (
    LEAST_DISTANCE,
    SETTLING,
    WINDOW,
    average_windows,
    compute_action_rate,
    compute_heading_velocity,
    compute_motor_limits,
    compute_weight,
    measure_course,
    to_json_number,
    to_roll_pitch_yaw,
    to_rotations,
)
from quadwalk.evaluation.rollout import Rollout
from quadwalk.robot.mirror import place_at_home
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import compute_floor_height

GAITS = ("walk", "trot", "pace", "bound", "gallop", "pronk", "irregular")

SHORTEST = 0.03  # s: a foot that leaves the ground for less has chattered, and one that touches
# it for less, and less than half as long as it does in its strides, has brushed it in its swing
TOLERANCE = 1 / 8  # of a stride: half the distance between neighboring ideal gaits
REGULAR = 0.7  # least mean resultant length of a foot's phases: they scatter by 0.13 of a stride
FEWEST_STRIDES = 2  # of the reference foot, to speak of a gait

_REFERENCE = 0  # FR


@dataclass(frozen=True)
class Footfalls:
    """How four feet (FR, FL, RR, RL) meet the ground; NaN where there is nothing to measure."""

    gait: str  # one of GAITS
    stride_frequency: float  # Hz, mean over the feet that make strides
    duty_factor: np.ndarray  # (4,) fraction of its strides that a foot is on the ground
    phase: np.ndarray  # (4,) in [0, 1), touchdown after FR's, in strides; FR's is 0
    regularity: np.ndarray  # (4,) mean resultant length of the phases: 1 always the same, 0 random


@dataclass(frozen=True)
class Gait(Footfalls):
    """The figures of one episode beside its footfalls; joints are in the quadruped's order."""

    fell: bool
    end: str  # how it ended, as in the rollout
    # as in `Course`
    duration: float  # s
    distance: float  # m
    speed: float  # m/s
    lateral_drift: float  # m
    heading_drift: float  # rad, change of yaw, whole turns included
    stride_length: float  # m, horizontal speed / stride frequency, once settled
    swing_height: np.ndarray  # (4,) m, median over swings of the sole's greatest height
    swing_height_p10: np.ndarray  # (4,) m, the 10th percentile of these
    slip: np.ndarray  # (4,) m/s, mean horizontal speed of the point that touches the ground
    slip_share: np.ndarray  # (4,) how far that point slides on the ground, of the way of the hips
    touchdown_speed: np.ndarray  # (4,) m/s, mean speed of the foot before it touches down
    body_height: np.ndarray  # (3,) m, mean, least, greatest height of the base's origin
    roll_range: float  # rad, greatest less least roll
    pitch_range: float  # rad, the same for pitch
    cost_of_transport: float  # energy per meter / weight
    froude: float  # speed^2 / (g * hip height)
    torque_mean: np.ndarray  # (12,) mean of |torque| / effort limit
    torque_peak: np.ndarray  # (12,) greatest |torque| / effort limit
    torque_reversals: np.ndarray  # (12,) share of control steps in which the torque changes sign
    joint_speed_mean: np.ndarray  # (12,) mean of |joint velocity| / velocity limit
    joint_speed_peak: np.ndarray  # (12,) greatest |joint velocity| / velocity limit
    action_rate: float  # 1/s, root mean square rate of the actions, which are in [-1, 1]


def measure_gait(rollout: Rollout, quadruped: Quadruped) -> Gait:
    """Measure the gait of one episode.

    - Cost of transport: positive mechanical work over weight times distance (Tucker, "The
      energetic cost of moving about", American Scientist 63, 1975), without the motors' heat.
    - Froude number: speed squared over g times the hip's standing height. Animals change from
      walking to trotting near 0.5, to galloping near 2 to 3 (Alexander & Jayes, "A dynamic
      similarity hypothesis for the gaits of quadrupedal mammals", J. Zoology 201, 1983).
    - Slip: the foot is a sphere, so while it rolls its center moves though nothing slips; taken is
      the point of the sphere that touches the ground.
    - The way of the hips is that above the feet, at mean velocities over `WINDOW`: on a straight
      path the distance, in a turn on the spot what the turn asks of the feet.
    - Touch-down speed: of the foot's center in the control step before the one in which it touches.
    - Torques are means over a control step, so their peaks are those of 20 ms, not of an instant.
    """
    course, footfalls = measure_course(rollout), measure_footfalls(rollout)
    model = quadruped.make_full_model()
    centers, orientations = compute_foot_poses(model, quadruped.feet, rollout.qpos)
    radii = np.array([model.geom(foot).size[0] for foot in quadruped.feet])
    slip, slid = _measure_slip(rollout, centers, orientations, radii)
    rpy = to_roll_pitch_yaw(rollout.qpos[:, 3:7])
    yaw = np.unwrap(rpy[:, 2])
    height = rollout.qpos[:, 2] - compute_floor_height(model, rollout.qpos[:, :2])
    soles = centers[:, :, 2] - radii - compute_floor_height(model, centers[:, :, :2])
    way = _measure_way(rollout, model, quadruped)
    swing_heights = _find_swing_heights(rollout, soles)
    torque = np.abs(rollout.torque) / compute_motor_limits(rollout, quadruped)
    torque = torque if rollout.steps else np.full((1, 12), np.nan)
    rate = np.abs(rollout.qvel[:, 6:]) / quadruped.velocity
    return Gait(
        **vars(footfalls),
        fell=rollout.fell,
        end=rollout.end,
        duration=course.duration,
        distance=course.distance,
        speed=course.speed,
        lateral_drift=course.lateral_drift,
        heading_drift=float(yaw[-1] - yaw[0]),
        stride_length=_measure_stride_length(rollout, footfalls.stride_frequency),
        swing_height=_compute_percentiles(swing_heights, 50.0),
        swing_height_p10=_compute_percentiles(swing_heights, 10.0),
        slip=slip,
        slip_share=slid / (way if way > LEAST_DISTANCE else np.nan),
        touchdown_speed=_measure_touchdown_speeds(rollout, centers),
        body_height=np.array([height.mean(), height.min(), height.max()]),
        roll_range=float(np.ptp(rpy[:, 0])),
        pitch_range=float(np.ptp(rpy[:, 1])),
        cost_of_transport=course.energy_per_meter / compute_weight(rollout, model),
        froude=course.speed**2 / (quadruped.gravity * _measure_hip_height(model, quadruped)),
        torque_mean=torque.mean(axis=0),
        torque_peak=torque.max(axis=0),
        torque_reversals=_measure_reversals(rollout.torque),
        joint_speed_mean=rate.mean(axis=0),
        joint_speed_peak=rate.max(axis=0),
        action_rate=compute_action_rate(rollout),
    )


def flatten_gait(gait: Gait, quadruped: Quadruped) -> dict[str, float | str | bool | None]:
    """Return a gait as flat names and plain values for JSON: one per foot or leg joint.

    NaN becomes None.
    """
    labels = {4: quadruped.legs, 12: quadruped.joints, 3: ("mean", "least", "greatest")}
    metrics: dict[str, float | str | bool | None] = {}
    for field in fields(gait):
        value = getattr(gait, field.name)
        if isinstance(value, np.ndarray):
            for label, number in zip(labels[len(value)], value, strict=True):
                metrics[f"{field.name}.{label}"] = to_json_number(number)
        else:
            metrics[field.name] = value if isinstance(value, bool | str) else to_json_number(value)
    return metrics


def find_middle_strides(rollout: Rollout, count: int, otherwise: float) -> tuple[float, float]:
    """Return where `count` strides in the middle of an episode begin and end, in control steps.

    Their length is the episode's mean. If no foot makes strides, the part returned is `otherwise`
    seconds long. Both ends may be fractions, and are within the episode.
    """
    frequency = measure_footfalls(rollout).stride_frequency
    seconds = count / frequency if frequency > 0 else otherwise
    middle, half = rollout.steps / 2, seconds / rollout.control_dt / 2
    return max(middle - half, 0.0), min(middle + half, float(rollout.steps))


def compute_foot_poses(
    model: mujoco.MjModel, feet: tuple[str, ...], qpos: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the poses of the `feet`, by name, in the states `qpos` (T, 19).

    Returns the world positions of the centers of their spheres, (T, 4, 3) in m. With them come the
    orientations of the calves that carry them, (T, 4, 4), quaternions wxyz.
    """
    data = mujoco.MjData(model)
    geoms = [model.geom(foot).id for foot in feet]
    calves = model.geom_bodyid[geoms]
    centers, orientations = np.empty((len(qpos), 4, 3)), np.empty((len(qpos), 4, 4))
    for row, state in enumerate(qpos):
        data.qpos = state
        mujoco.mj_kinematics(model, data)
        centers[row], orientations[row] = data.geom_xpos[geoms], data.xquat[calves]
    return centers, orientations


def _find_settled_step(rollout: Rollout) -> int:
    """Return the control step from which strides are measured; 0 if the episode is too short."""
    settling = round(SETTLING / rollout.control_dt)
    return settling if rollout.steps >= 3 * settling else 0


def _measure_stride_length(rollout: Rollout, frequency: float) -> float:
    """Return the mean stride length, m: horizontal speed over the stride `frequency`, Hz.

    With velocity commands the speed is measured in the frame of the heading.
    """
    if not frequency > 0:
        return np.nan
    velocity = rollout.qvel
    if rollout.command is not None:
        velocity = compute_heading_velocity(rollout.qpos, rollout.control_dt)
    mean = velocity[_find_settled_step(rollout) :, :2].mean(axis=0)
    return float(np.linalg.norm(mean) / frequency)


def _measure_hip_height(model: mujoco.MjModel, quadruped: Quadruped) -> float:
    """Return the mean height of the thigh joints in the home pose, m."""
    data = place_at_home(quadruped, model)
    return float(np.mean([data.joint(thigh).xanchor[2] for thigh in quadruped.joints[1::3]]))


def _find_swing_heights(rollout: Rollout, soles: np.ndarray) -> list[np.ndarray]:
    """Return the sole's greatest height in each swing, m: an array (n,) for each foot.

    `soles` (T + 1, 4) are the heights in each state; a swing is between two contacts.
    """
    contact = remove_chatter(rollout.contact, rollout.control_dt)
    heights = []
    for foot in range(4):
        sole = soles[1:, foot]  # contact is known at the ends of steps
        lifts = np.flatnonzero(contact[:-1, foot] & ~contact[1:, foot]) + 1
        lands = find_touchdowns(contact[:, foot])
        swings = [(lift, lands[lands > lift][0]) for lift in lifts if np.any(lands > lift)]
        heights.append(np.array([sole[lift:land].max() for lift, land in swings]))
    return heights


def _compute_percentiles(values: list[np.ndarray], percentile: float) -> np.ndarray:
    """Return a percentile of each array, (len(values),); NaN for an empty one."""
    return np.array([np.percentile(x, percentile) if len(x) else np.nan for x in values])


def _measure_touchdown_speeds(rollout: Rollout, centers: np.ndarray) -> np.ndarray:
    """Return each foot's mean speed before it touches down (4,), m/s.

    `centers` (T + 1, 4, 3) are the feet's places in each state, m.
    """
    contact = remove_chatter(rollout.contact, rollout.control_dt)
    speeds = np.linalg.norm(np.diff(centers, axis=0), axis=2) / rollout.control_dt
    means = np.full(4, np.nan)
    for foot in range(4):
        rows = find_touchdowns(contact[:, foot])
        if len(rows):
            means[foot] = speeds[rows - 1, foot].mean()
    return means


def _measure_reversals(torque: np.ndarray) -> np.ndarray:
    """Return the share of the steps of `torque` (T, 12) in which its sign is not the last's."""
    if len(torque) < 2:
        return np.full(12, np.nan)
    return (torque[1:] * torque[:-1] < 0.0).mean(axis=0)


def _measure_way(rollout: Rollout, model: mujoco.MjModel, quadruped: Quadruped) -> float:
    """Return the mean way of the four hips over the ground, at mean velocities over `WINDOW`, m."""
    data = place_at_home(quadruped, model)
    x, y, _ = np.array([data.joint(hip).xanchor for hip in quadruped.joints[::3]]).T
    motion = compute_heading_velocity(rollout.qpos, rollout.control_dt)
    window = min(round(WINDOW / rollout.control_dt), len(motion))
    if not window:
        return 0.0
    forward, left, turn = average_windows(motion, window).T[:, :, None]
    speed = np.hypot(forward - turn * y, left + turn * x).mean()
    return float(speed * rollout.steps * rollout.control_dt)


def _measure_slip(
    rollout: Rollout, centers: np.ndarray, orientations: np.ndarray, radii: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return speed (4,), m/s, and distance (4,), m, of the slip of each foot on the ground.

    It is the motion of the sphere's point that touches the ground. Only steps count at both ends of
    which the foot is on the ground. `centers` (T + 1, 4, 3), m, `orientations` (T + 1, 4, 4), wxyz,
    and `radii` (4,), m, are those of the feet.
    """
    slips, slid = np.full(4, np.nan), np.zeros(4)
    for k, radius in enumerate(radii):
        stays = rollout.contact[:-1, k] & rollout.contact[1:, k]
        if not stays.any():
            continue
        turn = to_rotations(orientations[2:, k]) * to_rotations(orientations[1:-1, k]).inv()
        shifts = np.diff(centers[1:, k], axis=0) + np.cross(turn.as_rotvec(), [0, 0, -radius])
        shifts = np.linalg.norm(shifts[stays, :2], axis=1)
        slips[k], slid[k] = shifts.mean() / rollout.control_dt, shifts.sum()
    return slips, slid


# Footfalls, from the feet's contacts alone.


def measure_footfalls(rollout: Rollout) -> Footfalls:
    """Measure the footfalls of an episode once it has settled."""
    return analyze_footfalls(rollout.contact[_find_settled_step(rollout) :], rollout.control_dt)


def analyze_footfalls(contact: np.ndarray, dt: float) -> Footfalls:
    """Return gait, stride frequency, duty factors and phases of `contact` (T, 4), bool.

    Rows are `dt` s apart, feet FR, FL, RR, RL. Chatter is removed first.
    """
    contact = remove_chatter(contact, dt)
    landings = [find_touchdowns(contact[:, foot]) for foot in range(4)]
    periods = [(rows[-1] - rows[0]) * dt / (len(rows) - 1) for rows in landings if len(rows) > 1]
    duty_factor = [_compute_duty_factor(contact[:, k], rows) for k, rows in enumerate(landings)]
    phase, regularity, even = _compute_phases(landings)
    strides = len(landings[_REFERENCE]) - 1
    regular = even and strides >= FEWEST_STRIDES and bool(np.all(regularity >= REGULAR))
    return Footfalls(
        gait=name_gait(phase) if regular else "irregular",
        stride_frequency=float(1 / np.mean(periods)) if periods else np.nan,
        duty_factor=np.array(duty_factor),
        phase=phase,
        regularity=regularity,
    )


def remove_chatter(contact: np.ndarray, dt: float) -> np.ndarray:
    """Return `contact` (T, 4), bool, without gaps and then contacts shorter than `SHORTEST`.

    At a gallop of six strides a second every contact is short. So a contact is removed only if it
    is also short beside those that hold most of the foot's time on the ground. What touches the
    first or last row stays: a part of it may be outside.
    """
    cleaned = np.array(contact, dtype=bool)
    longest = int(np.ceil(SHORTEST / dt - 1e-9)) - 1
    for foot in cleaned.T:
        for state in (False, True):
            edges = np.flatnonzero(foot[1:] != foot[:-1]) + 1
            inner = [(a, b) for a, b in itertools.pairwise(edges) if foot[a] == state]
            usual = _compute_usual_length([b - a for a, b in inner]) if state else np.inf
            for start, end in inner:
                if end - start <= longest and end - start < usual / 2:
                    foot[start:end] = not state
    return cleaned


def _compute_usual_length(lengths: list[np.signedinteger]) -> float:
    """Return the median length of contacts, each counted as often as it is long."""
    ordered = np.sort(lengths)
    sums = np.cumsum(ordered)
    return float(ordered[np.searchsorted(sums, sums[-1] / 2)]) if len(ordered) else np.inf


def find_touchdowns(foot: np.ndarray) -> np.ndarray:
    """Return the rows at which a contact of one foot begins; `foot` (T,) is True on the ground."""
    return np.flatnonzero(~foot[:-1] & foot[1:]) + 1


def find_contacts(foot: np.ndarray) -> np.ndarray:
    """Return the contacts (n, 2) of one foot: the first row of each, and the first row after it.

    `foot` (T,) is True where the foot is on the ground.
    """
    padded = np.concatenate([[0], foot, [0]]).astype(int)
    return np.flatnonzero(np.diff(padded)).reshape(-1, 2)


def name_gait(phase: np.ndarray) -> str:
    """Return which of `GAITS` has touchdowns at these phases (4,), of FR, FL, RR, RL, in strides.

    Feet of a pair (fore, hind) touch down together, alternate, or are split between those.
    Both pairs alternate: the lag of a fore foot behind the hind foot of its side tells. None is a
    pace, half a stride a trot, and a quarter, either way, a walk. With duty factors under one half
    a walk is an amble, its running form. Both pairs together: a pronk if all four are,
    else a bound. At least one pair split and none alternating: a gallop, also where a split pair
    with a pair together makes it a half-bound. Just one pair alternating, or a phase that is not
    finite: "irregular".
    """
    if not np.all(np.isfinite(phase)):
        return "irregular"
    fr, fl, rr, rl = phase
    fore, hind = measure_phase_distance(fr, fl), measure_phase_distance(rr, rl)
    alternate = [lag > 0.5 - TOLERANCE for lag in (fore, hind)]
    together = [lag < TOLERANCE for lag in (fore, hind)]
    if all(alternate):
        lag = average_phases(np.array([fr - rr, fl - rl]))[0]
        if measure_phase_distance(lag, 0.0) < TOLERANCE:
            return "pace"
        return "trot" if measure_phase_distance(lag, 0.5) < TOLERANCE else "walk"
    if any(alternate):
        return "irregular"
    if all(together):
        lag = measure_phase_distance(
            average_phases(np.array([fr, fl]))[0], average_phases(np.array([rr, rl]))[0]
        )
        return "pronk" if lag < TOLERANCE else "bound"
    return "gallop"


def measure_phase_distance(a: float, b: float) -> float:
    """Return the distance of two phases, in [0, 0.5] strides."""
    return float(abs((a - b + 0.5) % 1.0 - 0.5))


def average_phases(phases: np.ndarray) -> tuple[float, float]:
    """Return the mean direction in [0, 1) and the mean resultant length in [0, 1] of phases.

    See Mardia & Jupp, "Directional Statistics", 2000, section 2.2. Without phases: NaN and 0.
    """
    if len(phases) == 0:
        return np.nan, 0.0
    mean = np.mean(np.exp(2j * np.pi * np.asarray(phases)))
    direction = float(np.angle(mean) / (2 * np.pi)) % 1.0
    return direction % 1.0, float(abs(mean))  # a second time: -1e-17 % 1 is 1


def _compute_phases(landings: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return phases and regularities (4,) of the feet, and True if all make as many strides.

    `landings` are the rows of each foot's touchdowns.
    """
    reference = landings[_REFERENCE]
    phase, regularity = np.full(4, np.nan), np.zeros(4)
    if len(reference) < 2:
        return phase, regularity, False
    even = True
    for foot, rows in enumerate(landings):
        rows = rows[(rows >= reference[0]) & (rows < reference[-1])]
        stride = np.searchsorted(reference, rows, side="right") - 1
        start, end = reference[stride], reference[stride + 1]
        phase[foot], regularity[foot] = average_phases((rows - start) / (end - start))
        # A foot that lands twice as often, or every other time, is not in this gait.
        even &= abs(len(rows) - (len(reference) - 1)) <= max(1, 0.2 * (len(reference) - 1))
    return phase, regularity, bool(even)


def _compute_duty_factor(foot: np.ndarray, landings: np.ndarray) -> float:
    """Return the fraction of whole strides for which a foot is on the ground.

    Without a whole stride it is the fraction of all rows of `foot` (T,).
    """
    if len(landings) > 1:
        foot = foot[landings[0] : landings[-1]]
    return float(foot.mean()) if len(foot) else np.nan
