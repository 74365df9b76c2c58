"""URDFs of robots made for a test, and what a converted robot is held against."""

from collections.abc import Callable, Set
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.pinocchio_oracle import Pinocchio
from quadwalk.robot.mjcf import write_xml
from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.urdf import Urdf

SOLID = "0.01 0.01 0.01"
LIMIT = '<limit lower="-3" upper="3" effort="20" velocity="10"/>'
CORNERS = {"a": (0.2, 0.1), "b": (0.2, -0.1), "c": (-0.2, 0.1), "d": (-0.2, -0.1)}


def inertial(mass: float | str, moments: str = SOLID, xyz: str = "0 0 0", rpy: str = "0 0 0"):
    """`<inertial>` of principal moments, kg m^2, as text or of six entries from ixx to izz."""
    entries = moments.split()
    if len(entries) == 3:
        entries = [entries[0], "0", "0", entries[1], "0", entries[2]]
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    pairs = " ".join(f'{name}="{value}"' for name, value in zip(names, entries, strict=True))
    return (
        f'<inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{mass}"/>'
        f"<inertia {pairs}/></inertial>"
    )


def shape(geometry: str, xyz: str = "0 0 0", kind: str = "collision", rpy: str = "0 0 0") -> str:
    """A shape of a link, as `box size="1 2 3"` says."""
    return f'<{kind}><origin xyz="{xyz}" rpy="{rpy}"/><geometry><{geometry}/></geometry></{kind}>'


def link(name: str, *parts: str) -> str:
    return f'<link name="{name}">{"".join(parts)}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    axis: str = "0 0 1",
    xyz: str = "0 0 0",
    rpy: str = "0 0 0",
    kind: str = "revolute",
    extra: str = LIMIT,
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/>'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>{extra}</joint>'
    )


def robot(*parts: str, name: str = 'name="r"') -> str:
    return f"<robot {name}>{''.join(parts)}</robot>"


def plain_leg(
    name: str, x: float, y: float, thigh: str = "0 0 0", hip_rpy: str = "0 0 0", knee: str = LIMIT
) -> str:
    """Joints NAMEj1 .. 3 about x, y and y, and the links of hip and thigh, NAME1 and NAME2."""
    return (
        link(f"{name}1", inertial(0.5), shape('box size="0.02 0.02 0.02"'))
        + link(f"{name}2", inertial(0.5), shape('box size="0.02 0.02 0.02"'))
        + joint(f"{name}j1", "trunk", f"{name}1", "1 0 0", f"{x} {y} 0", hip_rpy)
        + joint(f"{name}j2", f"{name}1", f"{name}2", "0 1 0", thigh)
        + joint(f"{name}j3", f"{name}2", f"{name}3", "0 1 0", "0 0 -0.3", extra=knee)
    )


def ball_calf(name: str) -> str:
    """A calf of .2 m with a foot of 2 cm."""
    return link(f"{name}3", inertial(0.5), shape('sphere radius="0.02"', "0 0 -0.2"))


def quadruped(calf: Callable[[str], str], leg: Callable[[str, float, float], str] = plain_leg):
    """A trunk and legs `a` (front left), `b`, `c`, `d`, thighs .3 m.

    `calf(name)` is what the calf's link holds besides its inertial, and what follows that link.
    """
    trunk = link("trunk", inertial(5), shape('box size="0.4 0.2 0.1"'))
    legs = [leg(name, x, y) + calf(name) for name, (x, y) in CORNERS.items()]
    return robot(trunk, *legs)


def check_dynamics(
    urdf: Urdf, spec: mujoco.MjSpec, compared: Set[str] = frozenset(), states: int = 50
) -> None:
    """Masses, frames, mass matrix, bias and inverse dynamics are Pinocchio's, and so as XML.

    `compared` must be among what was.
    """
    in_memory = Pinocchio(urdf, spec.compile()).compute_errors(states)
    assert compared <= in_memory.keys()
    assert max(in_memory.values()) < 1e-10, in_memory
    from_xml = mujoco.MjModel.from_xml_string(write_xml(spec))
    through_xml = Pinocchio(urdf, from_xml).compute_errors(states)
    assert max(through_xml.values()) < 1e-5, through_xml


def make_frame(position, quat) -> np.ndarray:
    """(4, 4) of m and wxyz, by MuJoCo's own function."""
    turned, whole = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(turned, np.asarray(quat, float))
    whole[:3, :3], whole[:3, 3] = turned.reshape(3, 3), position
    return whole


def make_data(model: mujoco.MjModel, qpos: np.ndarray) -> mujoco.MjData:
    """The model in this pose, at rest, its contacts and all that follows from the pose computed."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def measure_knees(quadruped: Quadruped) -> dict[str, float]:
    """By leg, how far ahead of the thigh's joint the knee is, m, in the home pose."""
    data = make_data(quadruped.make_full_model(), quadruped.home)
    ahead = [data.joint(name).xanchor[0] for name in quadruped.joints]
    return dict(zip(quadruped.legs, np.subtract(ahead[2::3], ahead[1::3]), strict=True))


def simulate_standing(
    quadruped: Quadruped,
    seconds: float,
    kp: float | None = None,
    kd: float | np.ndarray | None = None,
) -> np.ndarray:
    """(n, 7) trunk poses under PD control of the home pose, from it, within the effort limits.

    Gains are in Nm/rad and Nm s/rad, by default as stiff as the robot is heavy and high.
    """
    model = quadruped.make_full_model()
    data = make_data(model, quadruped.home)
    kp = kp or 1.4 * model.body_subtreemass[0] * 9.81 * quadruped.home[2]
    kd = 0.025 * kp if kd is None else kd
    poses = []
    while data.time < seconds:
        torque = kp * (quadruped.home[7:] - data.qpos[7:]) - kd * data.qvel[6:]
        data.ctrl = np.clip(torque, -quadruped.effort, quadruped.effort)
        mujoco.mj_step(model, data)
        poses.append(data.qpos[:7].copy())
    return np.array(poses)


def check_stands(quadruped: Quadruped, seconds: float, height: float) -> None:
    """It is held above that share of its home height, and within 5 degrees of upright."""
    last = simulate_standing(quadruped, seconds)[-1]
    assert last[2] > height * quadruped.home[2]
    assert last[3] > np.cos(np.radians(5) / 2)


def limit(lower: float, upper: float, effort: float = 20.0) -> str:
    return f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="20"/>'


@dataclass(frozen=True)
class Walker:
    """A robot of 12 kg whose thighs and calves are 0.2 m long; its knees bend backward."""

    # rad, roll, pitch and yaw of the whole robot in the axes of its root link
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bolted: bool = False  # whether a fixed joint turns it, below a root link without mass
    names: tuple[str, ...] = ("FR", "FL", "RR", "RL")  # of the legs there
    size: float = 1.0  # factor of all lengths
    mass: float = 1.0  # factor of all masses
    inertia: float = 1.0  # factor of all inertias, besides
    hip: tuple[float, float] = (-0.8, 0.8)  # limits as in the file
    thigh: tuple[float, float] = (-1.0, 3.0)
    calf: tuple[float, float] = (-2.6, -0.6)
    wide: float = 0.06  # m, from hip to thigh
    effort: float = 20.0  # Nm

    def text(self) -> str:
        """Its URDF."""
        within = Rotation.from_euler("xyz", (0, 0, 0) if self.bolted else self.rpy)
        rpy = "0 0 0" if self.bolted else " ".join(map(str, self.rpy))
        box = f'box size="{0.4 * self.size} {0.2 * self.size} {0.1 * self.size}"'
        trunk = link("trunk", self.inertial(6, 0.04), shape(box, rpy=rpy))
        parts = [trunk]
        if self.bolted:
            turn = " ".join(map(str, self.rpy))
            parts = [link("root"), joint("bolt", "root", "trunk", rpy=turn, kind="fixed"), trunk]
        for name, (x, y) in zip(self.names, ((1, -1), (1, 1), (-1, -1), (-1, 1)), strict=True):
            hip = self.place(within.apply([0.2 * x, 0.08 * y, 0]))
            parts.append(self.leg(name, hip, rpy, y))
        return robot(*parts)

    def leg(self, name: str, hip: str, rpy: str, side: int) -> str:
        ball = shape(f'sphere radius="{0.02 * self.size}"')
        hip_joint, thigh_joint, calf_joint = (
            limit(*limits, self.effort) for limits in (self.hip, self.thigh, self.calf)
        )
        thigh, knee = self.place([0, self.wide * side, 0]), self.place([0, 0, -0.2])
        return (
            link(f"{name}_hip", self.inertial(0.5, 3e-4))
            + joint(f"{name}_hip_joint", "trunk", f"{name}_hip", "1 0 0", hip, rpy, extra=hip_joint)
            + link(f"{name}_thigh", self.inertial(0.8, 1.5e-3))
            + joint(
                f"{name}_thigh_joint", f"{name}_hip", f"{name}_thigh", "0 1 0", thigh,
                extra=thigh_joint,
            )
            + link(f"{name}_calf", self.inertial(0.15, 5e-4))
            + joint(
                f"{name}_calf_joint", f"{name}_thigh", f"{name}_calf", "0 1 0", knee,
                extra=calf_joint,
            )
            + link(f"{name}_foot", self.inertial(0.05, 1e-5), ball)
            + joint(f"{name}_bolt", f"{name}_calf", f"{name}_foot", xyz=knee, kind="fixed")
        )  # fmt: skip

    def place(self, point) -> str:
        """A point (3,), m, as a file has it."""
        return " ".join(str(float(x) * self.size) for x in point)

    def inertial(self, mass: float, moment: float) -> str:
        """`<inertial>` of kg and kg m^2, which depend on the units of mass and length."""
        moment *= self.mass * self.size**2 * self.inertia
        return inertial(mass * self.mass, " ".join([str(moment)] * 3))
