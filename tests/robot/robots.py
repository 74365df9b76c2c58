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


def replace_once(text: str, old: str, new: str) -> str:
    """Return `text` with the first `old`, which must be there, replaced by `new`."""
    assert old in text
    return text.replace(old, new, 1)


# The elements of a URDF, as text, are called by their tags.


def inertial(mass: float | str, moments: str = SOLID, xyz: str = "0 0 0", rpy: str = "0 0 0"):
    """Return `<inertial>` of `mass`, kg, and `moments`, kg m^2.

    The moments are three principal ones, or ixx to izz.
    """
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
    """Return `<collision>`, or the element `kind`, of a geometry such as `box size="1 2 3"`."""
    return f'<{kind}><origin xyz="{xyz}" rpy="{rpy}"/><geometry><{geometry}/></geometry></{kind}>'


def link(name: str, *parts: str) -> str:
    """Return `<link>` with the elements `parts`."""
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
    """Return `<joint>` of type `kind`, with a limit or other elements `extra`; m and rad."""
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/>'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>{extra}</joint>'
    )


def limit(lower: float, upper: float, effort: float = 20.0) -> str:
    """Return `<limit>` of rad and N m, and of 20 rad/s."""
    return f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="20"/>'


def robot(*parts: str) -> str:
    """Return the URDF of a robot with links and joints `parts`."""
    return f'<robot name="r">{"".join(parts)}</robot>'


def plain_leg(
    name: str, x: float, y: float, thigh: str = "0 0 0", hip_rpy: str = "0 0 0", knee: str = LIMIT
) -> str:
    """Return joints NAMEj1 .. 3 about x, y and y, and the links of hip and thigh, NAME1 and 2.

    The hip is at `x`, `y` of the trunk, m, turned by `hip_rpy`, rad. The thigh is at `thigh` of the
    hip. `knee` is the knee's `<limit>`.
    """
    cube = shape('box size="0.02 0.02 0.02"')
    return (
        link(f"{name}1", inertial(0.5), cube)
        + link(f"{name}2", inertial(0.5), cube)
        + joint(f"{name}j1", "trunk", f"{name}1", "1 0 0", f"{x} {y} 0", hip_rpy)
        + joint(f"{name}j2", f"{name}1", f"{name}2", "0 1 0", thigh)
        + joint(f"{name}j3", f"{name}2", f"{name}3", "0 1 0", "0 0 -0.3", extra=knee)
    )


def ball_calf(name: str) -> str:
    """Return the link NAME3, a calf of 0.2 m with a foot of 2 cm."""
    return link(f"{name}3", inertial(0.5), shape('sphere radius="0.02"', "0 0 -0.2"))


def quadruped(calf: Callable[[str], str], leg: Callable[[str, float, float], str] = plain_leg):
    """Return the URDF of a trunk and four legs with thighs of 0.3 m.

    Legs are called `a` (front left), `b` (front right), `c` (rear left) and `d` (rear right).
    `leg(name, x, y)` returns hip, thigh and joints of a leg whose hip is there, m. `calf(name)`
    returns its calf's link and what follows.
    """
    trunk = link("trunk", inertial(5), shape('box size="0.4 0.2 0.1"'))
    return robot(trunk, *(leg(name, x, y) + calf(name) for name, (x, y) in CORNERS.items()))


def check_dynamics(
    urdf: Urdf, spec: mujoco.MjSpec, quantities: Set[str] = frozenset(), states: int = 50
) -> None:
    """Assert that `spec`, and the MJCF written of it, have the dynamics of `urdf` in Pinocchio.

    Masses, frames, mass matrix, bias and inverse dynamics are compared in so many random states.
    `quantities`, such as "position of FR_foot", must be among what is compared.
    """
    in_memory = Pinocchio(urdf, spec.compile()).compute_errors(states)
    assert quantities <= in_memory.keys()
    assert max(in_memory.values()) < 1e-10, in_memory
    from_xml = mujoco.MjModel.from_xml_string(write_xml(spec))
    through_xml = Pinocchio(urdf, from_xml).compute_errors(states)
    assert max(through_xml.values()) < 1e-5, through_xml


def make_frame(position, quat) -> np.ndarray:
    """Return the frame (4, 4) of a position, m, and a quaternion wxyz, by MuJoCo's function."""
    rotation, frame = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(rotation, np.asarray(quat, float))
    frame[:3, :3], frame[:3, 3] = rotation.reshape(3, 3), position
    return frame


def make_data(model: mujoco.MjModel, qpos: np.ndarray) -> mujoco.MjData:
    """Return the model's data at `qpos`, at rest, after `mj_forward`: with contacts and forces."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def measure_knees(quadruped: Quadruped) -> dict[str, float]:
    """Return by leg how far, m, the knee is ahead of the thigh's joint in the home pose."""
    data = make_data(quadruped.make_full_model(), quadruped.home)
    ahead = [data.joint(name).xanchor[0] for name in quadruped.joints]
    return dict(zip(quadruped.legs, np.subtract(ahead[2::3], ahead[1::3]), strict=True))


def simulate_standing(
    quadruped: Quadruped,
    seconds: float,
    kp: float | None = None,
    kd: float | np.ndarray | None = None,
) -> np.ndarray:
    """Return trunk poses (n, 7) under PD control of the home pose, one after each physics step.

    MuJoCo C simulates the full model, within the effort limits. Gains are in Nm/rad and Nm s/rad,
    by default as stiff as the robot is heavy and high.
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
    """Assert that after so many seconds of PD control the robot is within 5 degrees of upright.

    Yaw counts too. Its trunk is then above a share `height` of its home height; what came before is
    not checked.
    """
    last = simulate_standing(quadruped, seconds)[-1]
    assert last[2] > height * quadruped.home[2]
    assert last[3] > np.cos(np.radians(5) / 2)


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

    def to_text(self) -> str:
        """Return the robot's URDF."""
        within = Rotation.from_euler("xyz", (0, 0, 0) if self.bolted else self.rpy)
        turn = " ".join(map(str, self.rpy))
        rpy = "0 0 0" if self.bolted else turn
        box = f'box size="{0.4 * self.size} {0.2 * self.size} {0.1 * self.size}"'
        parts = [link("trunk", self._make_inertial(6, 0.04), shape(box, rpy=rpy))]
        if self.bolted:
            bolt = joint("bolt", "root", "trunk", rpy=turn, kind="fixed")
            parts = [link("root"), bolt, *parts]
        for name, (x, y) in zip(self.names, ((1, -1), (1, 1), (-1, -1), (-1, 1)), strict=True):
            hip = self._place(within.apply([0.2 * x, 0.08 * y, 0]))
            parts.append(self._make_leg(name, hip, rpy, y))
        return robot(*parts)

    def _make_leg(self, name: str, hip: str, rpy: str, side: int) -> str:
        """Return the links and joints of a leg, whose `side` is 1 on the left, -1 on the right.

        `hip`, m, and `rpy`, rad, place its hip in the trunk.
        """
        places = (hip, self._place([0, self.wide * side, 0]), self._place([0, 0, -0.2]))
        limits = [limit(*ends, self.effort) for ends in (self.hip, self.thigh, self.calf)]
        masses, moments = (0.5, 0.8, 0.15), (3e-4, 1.5e-3, 5e-4)
        parent, text = "trunk", ""
        for row, part in enumerate(("hip", "thigh", "calf")):
            child, axis = f"{name}_{part}", "0 1 0" if row else "1 0 0"
            turn = "0 0 0" if row else rpy
            text += link(child, self._make_inertial(masses[row], moments[row]))
            text += joint(
                f"{child}_joint", parent, child, axis, places[row], turn, extra=limits[row]
            )
            parent = child
        ball = shape(f'sphere radius="{0.02 * self.size}"')
        text += link(f"{name}_foot", self._make_inertial(0.05, 1e-5), ball)
        return text + joint(f"{name}_bolt", parent, f"{name}_foot", xyz=places[2], kind="fixed")

    def _place(self, point) -> str:
        """Return a point (3,), m, times `size`, as the text of a file."""
        return " ".join(str(float(x) * self.size) for x in point)

    def _make_inertial(self, mass: float, moment: float) -> str:
        """Return `<inertial>` of `mass`, kg, and three moments, kg m^2, times the robot's factors.

        All three are `moment` before that.
        """
        moment *= self.mass * self.size**2 * self.inertia
        return inertial(mass * self.mass, " ".join([str(moment)] * 3))
