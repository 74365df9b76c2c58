"""A quadruped in the sagittal mirror, y -> -y: which joint and foot is the image of which."""

from typing import NamedTuple

import mujoco
import numpy as np

from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.scene import KINDS

_FLIP = np.diag([1.0, -1.0, 1.0])
# The largest difference between a robot and its mirror image, as shares of its standing height,
# its mass, or the larger value. The AlienGo and the nine quadrupeds of example-robot-data differ by
# less than 1e-10 in places, axes, limits, motors and masses. Their centers of mass differ by more:
# body mass times distance, over robot mass times height, is 0.051 for HyQ, else up to 0.012 (A1;
# AlienGo 0.010). Inertias differ by up to 0.0019 (HyQ; AlienGo 0.0010) of mass times height^2.
PLACE, VALUE, MOMENT, INERTIA = 0.005, 0.01, 0.1, 0.005


class Mirror(NamedTuple):
    """How a vector mirrors: number i of its image is `sign[i] * x[source[i]]`. Use `mirror`."""

    source: np.ndarray  # (n,) int
    sign: np.ndarray  # (n,) float32, 1 or -1

    def __call__(self, x):
        """The image of `x` (..., n)."""
        return self.sign * x[..., self.source]


def mirror(source, sign) -> Mirror:
    """A `Mirror`; `ValueError` where mirroring twice does not give the same again."""
    source, sign = np.asarray(source, int), np.asarray(sign, np.float32)
    whole = source.shape == sign.shape == (len(source),) and np.all(np.abs(sign) == 1)
    if not whole or not np.array_equal(np.sort(source), np.arange(len(source))):
        raise ValueError("a mirror needs one source and one sign, 1 or -1, for each number")
    if np.any(source[source] != np.arange(len(source))) or np.any(sign[source] != sign):
        raise ValueError("mirrored twice, a vector is not the same again")
    return Mirror(source, sign)


def joined(*mirrors: Mirror) -> Mirror:
    """The mirror of vectors one after another."""
    starts = np.cumsum([0, *(len(own.source) for own in mirrors)])
    sources = [own.source + start for own, start in zip(mirrors, starts, strict=False)]
    signs = [own.sign for own in mirrors]
    return mirror(np.concatenate([[], *sources]), np.concatenate([[], *signs]))


class RobotMirror(NamedTuple):
    """How what belongs to a robot's parts mirrors."""

    joints: Mirror  # (12,) joint angles, speeds and torques
    feet: Mirror  # (4,) a number of each foot


def standing(quadruped: Quadruped, model: mujoco.MjModel) -> tuple[mujoco.MjData, np.ndarray]:
    """A robot's `model` in its standing pose, and its joints' axes (12, 3) in the trunk's frame."""
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    mujoco.mj_kinematics(model, data)
    return data, data.xaxis[1:] @ data.xmat[model.jnt_bodyid[0]].reshape(3, 3)


def robot_mirror(quadruped: Quadruped, model: mujoco.MjModel) -> RobotMirror | str:
    """How the robot mirrors; one line that names the largest difference where it does not.

    From the structure in the standing pose of `model`, which is made from `quadruped`.
    """
    data, axes = standing(quadruped, model)
    trunk = int(model.jnt_bodyid[0])
    turn = data.xmat[trunk].reshape(3, 3)

    def placed(points: np.ndarray) -> np.ndarray:
        return (points - data.xpos[trunk]) @ turn  # in the trunk's frame

    mass, height = float(model.body_subtreemass[0]), float(quadruped.home[2])
    anchors = placed(data.xanchor[1:])
    geoms = [model.geom(name).id for name in quadruped.feet]
    soles = placed(data.geom_xpos[geoms])
    joints, feet = _nearest(anchors), _nearest(soles)
    # An axis is an axial vector.
    sign = np.where(np.sum(axes[joints] * (-axes @ _FLIP), axis=1) < 0, -1.0, 1.0)
    try:
        found = RobotMirror(mirror(joints, sign), mirror(feet, np.ones(4)))
    except ValueError:
        return "the robot is not its own mirror image: joints or feet of its sides do not pair"

    names = quadruped.joints
    # By what: of what, how different (n,) or (n, ...), how much may be.
    differences: dict[str, tuple[tuple[str, ...], np.ndarray, float]] = {}

    def compare(what: str, own: tuple[str, ...], off: np.ndarray, most: float) -> None:
        differences[what] = own, np.abs(off).reshape(len(own), -1).max(axis=1), most

    def values(what: str, x: np.ndarray) -> None:
        larger = np.maximum(np.maximum(np.abs(x), np.abs(x[joints])), 1e-9)
        compare(what, names, (x[joints] - x) / larger, VALUE)

    compare("place", names, anchors[joints] - anchors @ _FLIP, PLACE * height)
    compare("axis", names, axes[joints] + sign[:, None] * (axes @ _FLIP), PLACE)
    compare("standing angle", names, found.joints(quadruped.home[7:]) - quadruped.home[7:], PLACE)
    lower = np.where(sign > 0, quadruped.lower[joints], -quadruped.upper[joints])
    upper = np.where(sign > 0, quadruped.upper[joints], -quadruped.lower[joints])
    off = np.stack([lower - quadruped.lower, upper - quadruped.upper], axis=1)
    compare("limits", names, off, PLACE)
    for what in ("effort", "velocity", "friction"):
        values(what, getattr(quadruped, what))
    dofs = model.jnt_dofadr[1:]
    values("armature", model.dof_armature[dofs])
    values("damping", model.dof_damping[dofs].reshape(12, -1)[:, 0])
    bodies = np.r_[trunk, model.jnt_bodyid[1:]]
    images, own = np.r_[0, 1 + joints], tuple(model.body(body).name for body in bodies)
    masses, centers = model.body_mass[bodies], placed(data.xipos[bodies])
    compare("mass", own, masses[images] / masses - 1, VALUE)
    moments = masses[:, None] * (centers[images] - centers @ _FLIP) / (mass * height)
    compare("center of mass", own, moments, MOMENT)
    frames = turn.T @ data.ximat[bodies].reshape(-1, 3, 3)
    inertias = frames * model.body_inertia[bodies, None] @ frames.transpose(0, 2, 1)
    off = (inertias[images] - _FLIP @ inertias @ _FLIP) / (mass * height**2)
    compare("inertia", own, off, INERTIA)
    there = {model.geom(geom).name for geom in range(model.ngeom)}
    for spheres in (quadruped.feet, *KINDS):
        if there.issuperset(spheres):
            geoms = [model.geom(name).id for name in spheres]
            places, radii = placed(data.geom_xpos[geoms]), model.geom_size[geoms, 0]
            images = _nearest(places)
            compare(
                f"place of {spheres[0]}", spheres, places[images] - places @ _FLIP, PLACE * height
            )
            compare(f"radius of {spheres[0]}", spheres, radii[images] - radii, PLACE * height)
    what, (own, off, most) = max(
        differences.items(), key=lambda item: item[1][1].max() / item[1][2]
    )
    if off.max() <= most:
        return found
    return (
        f"the robot is not its own mirror image: {what} of {own[int(off.argmax())]!r} differs by "
        f"{off.max():.2g} ({most:.2g} would do)"
    )


def _nearest(points: np.ndarray) -> np.ndarray:
    """(n,) of each of the `points` (n, 3) which one is nearest to its image."""
    return np.linalg.norm(points[None] - (points @ _FLIP)[:, None], axis=2).argmin(axis=1)
