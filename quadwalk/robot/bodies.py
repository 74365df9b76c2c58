"""Many bodies for one policy: quadrupeds that differ as published ones do, made from the AlienGo.

Their figures are without units, as dynamic similarity has them (Alexander and Jayes 1983): lengths
in leg lengths L, masses by that of the robot, torques in m g L, speeds in 1 / sqrt(L / g). Each is
drawn on its own, so that few bodies are scaled copies of others.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import mujoco
import numpy as np

from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.robot.scene import HOME, compute_rotation

GRAVITY = 9.81  # m/s^2, under which torques and speeds are similar
LIGHTEST, HEAVIEST = 2.3, 140.0  # kg
# Shares of bodies whose front and whose hind knees point ahead: as those of most robots, as of HyQ
# and ANYmal, as of robots with all knees ahead, and as of none that is published.
KNEES = {(False, False): 0.5, (False, True): 0.3, (True, True): 0.15, (True, False): 0.05}
HELD_OUT_WITHIN = 0.03  # a body this close to a held-out one, in all figures, is drawn anew


@dataclass(frozen=True)
class Body:
    """The figures of a quadruped; those of its legs are alike but for the knees."""

    leg: float  # m, L: from the thigh's joint to the foot's center, the knee stretched
    density: float  # kg/m^3, the robot's mass over L^3
    height: float  # of the thighs' joints above the feet's centers, standing
    thigh: float  # length
    length: float  # from the hind to the front hips' joints
    width: float  # from the right to the left hips' joints
    offset: float  # from the hip's joint to the thigh's, aside
    foot: float  # radius
    knee: float  # radius of the knee, which sticks out of the thigh where it is thick
    legs: float  # share of the mass that the legs have
    hips: float  # share of a leg's mass that the hip has
    calf: float  # share that calf and foot have
    ahead: float  # of the middle of the hips, where the trunk's center of mass is
    above: float  # of them
    spread_ahead: float  # factor by which the trunk's mass reaches farther along than its shapes
    spread_aside: float  # the same aside and up
    effort: float  # largest torque of the thighs
    hip_effort: float  # over that
    calf_effort: float  # over that of the thighs
    speed: float  # largest speed of the thighs
    hip_speed: float  # over that
    calf_speed: float  # over that of the thighs
    rotor: float  # armature over m L^2
    friction: float  # of the joints
    damping: float  # of the joints
    aside: float  # rad, the most that a hip turns to either side
    straight: float  # rad, the most that a knee stretches: 0 is straight
    front_knees: bool = False  # whether they point ahead
    hind_knees: bool = False

    @property
    def mass(self) -> float:
        """Mass of the robot, kg."""
        return self.density * self.leg**3


# Lowest and highest of each figure. They span those of the robots of docs/zoo.md, with a margin.
RANGES: dict[str, tuple[float, float]] = {
    "leg": (0.2, 0.85),
    "density": (60.0, 300.0),
    "height": (0.62, 0.84),
    "thigh": (0.44, 0.54),
    "length": (0.75, 1.4),
    "width": (0.16, 0.68),
    "offset": (0.0, 0.32),
    "foot": (0.028, 0.07),
    "knee": (0.03, 0.11),
    "legs": (0.25, 0.66),
    "hips": (0.28, 0.75),
    "calf": (0.05, 0.17),
    "ahead": (-0.08, 0.09),
    "above": (-0.03, 0.13),
    "spread_ahead": (0.65, 1.75),
    "spread_aside": (0.55, 1.6),
    "effort": (0.2, 1.3),
    "hip_effort": (0.5, 1.5),
    "calf_effort": (0.7, 2.0),
    "speed": (1.8, 15.0),
    "hip_speed": (0.6, 1.8),
    "calf_speed": (0.5, 1.1),
    "rotor": (0.001, 0.006),
    "friction": (0.0, 0.005),
    "damping": (0.0, 0.012),
    "aside": (0.43, 1.22),
    "straight": (0.0, 0.95),
}

# The robots of docs/zoo.md: no body of training resembles one, so that they show what a policy does
# with robots it has not met. L in m and the mass in kg, then `thigh`, `length` (of the thighs'
# joints) and `width`, as their URDFs in example-robot-data 6.0.0 and pybullet_data 3.2.7 have them.
HELD_OUT: dict[str, tuple[float, float, float, float, float]] = {
    "A1": (0.400, 13.74, 0.500, 0.903, 0.235),
    "ANYmal B": (0.588, 30.48, 0.464, 1.160, 0.395),
    "ANYmal C": (0.630, 52.13, 0.480, 1.143, 0.330),
    "B1": (0.700, 55.69, 0.500, 0.987, 0.206),
    "Go1": (0.426, 13.10, 0.500, 0.883, 0.220),
    "Go2": (0.426, 16.09, 0.500, 0.908, 0.216),
    "HyQ": (0.696, 86.77, 0.503, 1.073, 0.595),
    "Laikago": (0.500, 25.43, 0.500, 0.878, 0.348),
    "Solo12": (0.325, 2.50, 0.506, 1.197, 0.538),
    "A1 of pybullet_data": (0.400, 12.46, 0.500, 0.915, 0.235),
    "AlienGo of pybullet_data": (0.500, 20.64, 0.500, 0.960, 0.204),
    "Laikago of pybullet_data": (0.504, 25.57, 0.502, 0.867, 0.325),
    "Vision 60 of pybullet_data": (0.534, 26.90, 0.468, 1.217, 0.592),
    "Spirit 40 of pybullet_data": (0.412, 11.51, 0.500, 1.100, 0.340),
}


def sample_bodies(number: int, seed: int) -> Iterator[Body]:
    """Yield `number` bodies, the same ones for a seed; the first of many are those of few."""
    rng = np.random.default_rng(seed)
    while number > 0:
        body = _sample_body(rng)
        if LIGHTEST < body.mass < HEAVIEST and not is_held_out(body):
            number -= 1
            yield body


def _sample_body(rng: np.random.Generator) -> Body:
    shares = dict(zip(RANGES, rng.uniform(size=len(RANGES)), strict=True))
    figures = {
        name: float(
            low + (high - low) * shares[name] if low <= 0.0 else low * (high / low) ** shares[name]
        )
        for name, (low, high) in RANGES.items()
    }
    front, hind = list(KNEES)[rng.choice(len(KNEES), p=list(KNEES.values()))]
    return Body(**figures, front_knees=front, hind_knees=hind)


def is_held_out(body: Body) -> bool:
    """Return True for a body that resembles a robot of `HELD_OUT`."""
    figures = np.array([body.leg, body.mass, body.thigh, body.length, body.width])
    return any(
        np.all(np.abs(figures / robot - 1.0) < HELD_OUT_WITHIN) for robot in HELD_OUT.values()
    )


def make_bodies(number: int, seed: int) -> list[Quadruped]:
    """Return `number` quadrupeds, the same ones for a seed."""
    return [
        make_body(body, f"body{place}") for place, body in enumerate(sample_bodies(number, seed))
    ]


@cache
def _load_base() -> Quadruped:
    """Return the AlienGo without its visual shapes."""
    base = load_quadruped()
    for geom in list(base.spec.geoms):
        geom.material = ""
        if geom.classname.name == "visual":
            base.spec.delete(geom)
    return base


def make_body(body: Body, name: str = "body") -> Quadruped:
    """Return the quadruped of these figures, with the AlienGo's names of joints and feet.

    Its shapes and inertias are the AlienGo's, stretched link by link; left and right are exact
    mirror images.
    """
    base = _load_base()
    spec = base.spec.copy()
    spec.modelname = name
    leg, torque = body.leg, body.mass * GRAVITY * body.leg
    lengths = np.array([body.thigh, 1.0 - body.thigh]) * leg
    stretches, size = lengths / _measure_links(base), leg / sum(_measure_links(base))
    shares = np.array([body.hips, 1.0 - body.hips - body.calf, body.calf])
    masses = body.legs * body.mass / 4.0 * shares
    offset = body.offset * leg
    _scale_trunk(base, spec, body)
    joints = []
    for place in range(4):
        ahead, left = place < 2, place % 2 == 1
        knee_ahead = body.front_knees if ahead else body.hind_knees
        along, aside = -1.0 if knee_ahead else 1.0, 1.0 if left else -1.0
        links = [spec.joint(joint).parent for joint in base.joints[3 * place : 3 * place + 3]]
        # The left leg is the pattern of both.
        pattern = 3 * (1 if ahead else 3)
        like = [base.spec.joint(joint).parent for joint in base.joints[pattern : pattern + 3]]
        places = (
            [(0.5 if ahead else -0.5) * body.length * leg, aside * body.width * leg / 2, 0.0],
            [0.0, aside * offset, 0.0],
            [0.0, 0.0, -lengths[0]],
        )
        factors = (
            np.array([size, aside * max(offset / abs(like[1].pos[1]), 0.3 * size), size]),
            np.array([along * size, aside * size, stretches[0]]),
            np.array([along * size, aside * size, stretches[1]]),
        )
        for i in range(3):
            links[i].pos = places[i]
            _scale_link(links[i], like[i], masses[i], factors[i])
        links[1].add_geom(
            links[1].geoms[0].classname,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[body.knee * leg, 0, 0],
            pos=[0.0, 0.0, -lengths[0]],
        )
        foot = spec.geom(base.feet[place])
        foot.size = [body.foot * leg, 0, 0]
        foot.pos = [0.0, 0.0, -lengths[1]]
        site = spec.site(base.feet[place])
        site.pos, site.size = foot.pos, [1.1 * body.foot * leg] * 3
        joints.append(_list_joints(body, base, place, along))
    home = base.home.copy()
    home[2] = (body.height + body.foot) * leg
    lower, upper, home[7:] = np.concatenate(joints, axis=1)
    effort = np.tile([body.hip_effort, 1.0, body.calf_effort], 4) * body.effort * torque
    time = np.sqrt(leg / GRAVITY)
    velocity = np.tile([body.hip_speed, 1.0, body.calf_speed], 4) * body.speed / time
    for place, joint_name in enumerate(base.joints):
        joint = spec.joint(joint_name)
        joint.range = [lower[place], upper[place]]
        joint.actfrcrange = [-effort[place], effort[place]]
        joint.userdata = [velocity[place]]
        joint.armature = body.rotor * body.mass * leg**2
        joint.damping[0] = body.damping * torque * time
        joint.frictionloss = body.friction * torque
        spec.actuator(joint_name).ctrlrange = joint.actfrcrange
    spec.key(HOME).qpos = home
    return replace(
        base,
        name=name,
        urdf="",
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        friction=np.full(12, body.friction * torque),
        home=home,
        notes=(),
        spec=spec,
    )


def _list_joints(body: Body, base: Quadruped, place: int, along: float) -> np.ndarray:
    """Return the lower limits, upper limits and home angles of a leg's joints, (3, 3) rad.

    Knees are behind where `along` is 1, and ahead where it is -1. The foot is below the thigh's
    joint: thigh, calf and their distance are a triangle.
    """
    thigh, calf, high = body.thigh, 1.0 - body.thigh, body.height
    knee = np.arccos((thigh**2 + calf**2 - high**2) / (2 * thigh * calf))
    lean = np.arccos((thigh**2 + high**2 - calf**2) / (2 * thigh * high))
    leg = slice(3 * place, 3 * place + 3)
    lower, upper = base.lower[leg].copy(), base.upper[leg].copy()
    bend = knee - np.pi
    lower[0], upper[0] = -body.aside, body.aside
    upper[2] = max(-body.straight, bend + 0.3)
    lower[2] = min(lower[2], bend - 0.3)
    home = np.array([0.0, lean, bend])
    if along < 0:
        home[1:] = -home[1:]
        lower[1:], upper[1:] = -upper[1:], -lower[1:]
    return np.stack([lower, upper, home])


def _measure_links(base: Quadruped) -> tuple[float, float]:
    """Return the lengths of thigh and calf, m."""
    calf = base.spec.joint(base.joints[2]).parent
    foot = base.spec.geom(base.feet[0])
    return float(np.linalg.norm(calf.pos)), float(np.linalg.norm(foot.pos))


def _scale_trunk(base: Quadruped, spec: mujoco.MjSpec, body: Body) -> None:
    """Scale the trunk to the hips' places, with its share of the mass."""
    like, trunk = base.spec.body(base.trunk), spec.body(base.trunk)
    front = base.spec.joint(base.joints[3]).parent.pos  # FL, ahead and to the left of the middle
    size = body.leg / sum(_measure_links(base))
    factor = np.array(
        [body.length * body.leg / (2 * front[0]), body.width * body.leg / (2 * front[1]), size]
    )
    _scale_shapes(trunk, like, factor)
    spread = factor * [body.spread_ahead, body.spread_aside, body.spread_aside]
    moments = _compute_moments(like) * np.outer(spread, spread)
    # Its own mirror image: no products with y.
    moments[1, [0, 2]] = moments[[0, 2], 1] = 0.0
    _set_inertia(trunk, (1.0 - body.legs) * body.mass, moments / like.mass)
    trunk.ipos = [body.ahead * body.leg, 0.0, body.above * body.leg]


def _scale_link(
    link: mujoco.MjsBody, like: mujoco.MjsBody, mass: float, factor: np.ndarray
) -> None:
    """Make `link` as `like` is, scaled along its axes by `factor` (3,), < 0 mirrors it."""
    _scale_shapes(link, like, factor)
    _set_inertia(link, mass, _compute_moments(like) / like.mass * np.outer(factor, factor))
    link.ipos = factor * like.ipos


def _scale_shapes(link: mujoco.MjsBody, like: mujoco.MjsBody, factor: np.ndarray) -> None:
    """Scale the shapes of `link`, as many as of `like`; their axes are along those of the link.

    A cylinder is as thick as the mean of both sides.
    """
    for geom, pattern in zip(link.geoms, like.geoms, strict=True):
        axes = np.abs(compute_rotation(pattern.quat)).round(6)
        along = axes.T @ np.abs(factor)
        geom.pos = factor * pattern.pos
        geom.quat = pattern.quat
        if pattern.type == mujoco.mjtGeom.mjGEOM_BOX:
            geom.size = along * pattern.size
        else:
            geom.size = pattern.size * [(along[0] + along[1]) / 2, along[2], 1.0]


def _compute_moments(like: mujoco.MjsBody) -> np.ndarray:
    """Return the second moments of a body's mass about its center, (3, 3) kg m^2, in its axes."""
    turn = compute_rotation(like.iquat)
    inertia = turn @ np.diag(like.inertia) @ turn.T
    moments: np.ndarray = np.trace(inertia) / 2.0 * np.eye(3) - inertia
    return moments


def _set_inertia(link: mujoco.MjsBody, mass: float, moments: np.ndarray) -> None:
    """Give `link` a `mass`, kg, with second moments (3, 3), m^2, of each kg."""
    inertia = mass * (np.trace(moments) * np.eye(3) - moments)
    sizes, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    link.mass, link.inertia = mass, sizes
    mujoco.mju_mat2Quat(link.iquat, axes.ravel())
