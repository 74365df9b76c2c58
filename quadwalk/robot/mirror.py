"""A quadruped in the sagittal mirror, y -> -y: which joint and foot is the image of which."""

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.scene import SPHERE_NAMES

_FLIP = np.diag([1.0, -1.0, 1.0])
# The largest difference between a robot and its mirror image, as shares of its standing height,
# its mass, or the larger value. The AlienGo and the nine quadrupeds of example-robot-data differ by
# less than 1e-10 in places, axes, limits, motors and masses. Their centers of mass differ by more:
# body mass times distance, over robot mass times height, is 0.051 for HyQ, else up to 0.012 (A1;
# AlienGo 0.010). Inertias differ by up to 0.0019 (HyQ; AlienGo 0.0010) of mass times height^2.
PLACE, VALUE, MOMENT, INERTIA = 0.005, 0.01, 0.1, 0.005
# By which a joint's numbers change in the mirror where hips turn about x, and others about y.
STANDARD_SIGNS = np.tile([-1.0, 1.0, 1.0], 4)


class Mirror(NamedTuple):
    """The mirroring of a vector: number i of its image is `sign[i] * x[source[i]]`."""

    source: np.ndarray  # (n,) int
    sign: np.ndarray  # (n,) float32, 1 or -1

    def __call__(self, x):
        """Return the image of `x` (..., n)."""
        return self.sign * x[..., self.source]


def make_mirror(source, sign) -> Mirror:
    """Make a `Mirror`; raise `ValueError` where mirroring twice does not give the same again."""
    source, sign = np.asarray(source, int), np.asarray(sign, np.float32)
    fits = source.shape == sign.shape == (len(source),) and np.all(np.abs(sign) == 1)
    if not fits or not np.array_equal(np.sort(source), np.arange(len(source))):
        raise ValueError("a mirror needs one source and one sign, 1 or -1, for each number")
    if np.any(source[source] != np.arange(len(source))) or np.any(sign[source] != sign):
        raise ValueError("mirrored twice, a vector is not the same again")
    return Mirror(source, sign)


def join_mirrors(*mirrors: Mirror) -> Mirror:
    """Return the mirror of vectors one after another."""
    starts = np.cumsum([0, *(len(mirror.source) for mirror in mirrors)])
    sources = [mirror.source + start for mirror, start in zip(mirrors, starts, strict=False)]
    signs = [mirror.sign for mirror in mirrors]
    return make_mirror(np.concatenate([[], *sources]), np.concatenate([[], *signs]))


class NotSymmetric(Exception):
    """A robot or task that is not its own mirror image; the message is one line that says why."""


class RobotMirror(NamedTuple):
    """The mirroring of a robot's parts."""

    joints: Mirror  # (12,) joint angles, speeds and torques
    feet: Mirror  # (4,) a number of each foot


def place_at_home(quadruped: Quadruped, model: mujoco.MjModel) -> mujoco.MjData:
    """Return the kinematics of a robot's `model` in its home pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    mujoco.mj_kinematics(model, data)
    return data


def compute_home_axes(quadruped: Quadruped, model: mujoco.MjModel) -> np.ndarray:
    """Return the joints' axes (12, 3) in the trunk's frame, in the home pose."""
    data = place_at_home(quadruped, model)
    return data.xaxis[1:] @ data.xmat[model.jnt_bodyid[0]].reshape(3, 3)


def find_robot_mirror(quadruped: Quadruped, model: mujoco.MjModel) -> RobotMirror:
    """Return how the standing robot mirrors; `NotSymmetric` names the largest difference."""
    image = _Image(quadruped, model)
    try:
        mirrors = RobotMirror(
            make_mirror(image.joints, image.sign),
            make_mirror(_find_images(image.find_centers(quadruped.feet)), [1] * 4),
        )
    except ValueError:
        raise NotSymmetric(
            "the robot is not its own mirror image: joints or feet of its sides do not pair"
        ) from None
    differences = [*image.compare_joints(), *image.compare_bodies(), *image.compare_spheres()]
    quantity, parts, off, most = max(differences, key=lambda d: np.abs(d[2]).max() / d[3])
    sizes = np.abs(off).reshape(len(parts), -1).max(axis=1)
    if sizes.max() > most:
        raise NotSymmetric(
            f"the robot is not its own mirror image: {quantity} of {parts[int(sizes.argmax())]!r} "
            f"differs by {sizes.max():.2g} ({most:.2g} would do)"
        )
    return mirrors


# A quantity, names of its parts, differences of each to its image (parts, ...), the largest allowed
_Difference = tuple[str, tuple[str, ...], np.ndarray, float]


class _Image:
    """A robot in its home pose beside its mirror image."""

    def __init__(self, quadruped: Quadruped, model: mujoco.MjModel) -> None:
        self._quadruped, self._model = quadruped, model
        self._data = place_at_home(quadruped, model)
        self._axes = compute_home_axes(quadruped, model)
        self._trunk = int(model.jnt_bodyid[0])
        self._turn = self._data.xmat[self._trunk].reshape(3, 3)
        self._height = float(quadruped.home[2])
        self._anchors = self._to_trunk(self._data.xanchor[1:])
        self.joints = _find_images(self._anchors)
        # An axis is an axial vector.
        along = np.sum(self._axes[self.joints] * (-self._axes @ _FLIP), axis=1)
        self.sign = np.where(along < 0, -1.0, 1.0)

    def _to_trunk(self, points: np.ndarray) -> np.ndarray:
        """Return world points (n, 3) in the trunk's frame."""
        return (points - self._data.xpos[self._trunk]) @ self._turn

    def find_centers(self, names: tuple[str, ...]) -> np.ndarray:
        """Return the centers (n, 3) of geoms in the trunk's frame."""
        return self._to_trunk(self._data.geom_xpos[[self._model.geom(name).id for name in names]])

    def compare_joints(self) -> Iterator[_Difference]:
        """Compare the joints' places, axes, standing angles, limits and motors."""
        quadruped, joints, sign = self._quadruped, self.joints, self.sign
        names, home, dofs = quadruped.joints, quadruped.home[7:], self._model.jnt_dofadr[1:]
        place_errors = self._anchors[joints] - self._anchors @ _FLIP
        yield "place", names, place_errors, PLACE * self._height
        axis_errors = self._axes[joints] + sign[:, None] * (self._axes @ _FLIP)
        yield "axis", names, axis_errors, PLACE
        yield "standing angle", names, sign * home[joints] - home, PLACE
        lower = np.where(sign > 0, quadruped.lower[joints], -quadruped.upper[joints])
        upper = np.where(sign > 0, quadruped.upper[joints], -quadruped.lower[joints])
        off = np.stack([lower - quadruped.lower, upper - quadruped.upper], axis=1)
        yield "limits", names, off, PLACE
        values = {name: getattr(quadruped, name) for name in ("effort", "velocity", "friction")}
        values["armature"] = self._model.dof_armature[dofs]
        values["damping"] = self._model.dof_damping[dofs].reshape(12, -1)[:, 0]
        for quantity, x in values.items():
            larger = np.maximum(np.maximum(np.abs(x), np.abs(x[joints])), 1e-9)
            yield quantity, names, (x[joints] - x) / larger, VALUE

    def compare_bodies(self) -> Iterator[_Difference]:
        """Compare masses, centers of mass and inertias of trunk and links."""
        model, height, mass = self._model, self._height, float(self._model.body_subtreemass[0])
        bodies, images = np.r_[self._trunk, model.jnt_bodyid[1:]], np.r_[0, 1 + self.joints]
        names = tuple(model.body(body).name for body in bodies)
        masses, centers = model.body_mass[bodies], self._to_trunk(self._data.xipos[bodies])
        yield "mass", names, masses[images] / masses - 1, VALUE
        moments = masses[:, None] * (centers[images] - centers @ _FLIP) / (mass * height)
        yield "center of mass", names, moments, MOMENT
        frames = self._turn.T @ self._data.ximat[bodies].reshape(-1, 3, 3)
        inertias = frames * model.body_inertia[bodies, None] @ frames.transpose(0, 2, 1)
        off = (inertias[images] - _FLIP @ inertias @ _FLIP) / (mass * height**2)
        yield "inertia", names, off, INERTIA

    def compare_spheres(self) -> Iterator[_Difference]:
        """Compare places and radii of the model's spheres of contact."""
        model, most = self._model, PLACE * self._height
        geoms = {model.geom(geom).name for geom in range(model.ngeom)}
        for names in (self._quadruped.feet, *SPHERE_NAMES):
            if geoms.issuperset(names):
                places = self.find_centers(names)
                radii = np.array([model.geom(name).size[0] for name in names])
                images = _find_images(places)
                place_errors = places[images] - places @ _FLIP
                yield f"place of {names[0]}", names, place_errors, most
                yield f"radius of {names[0]}", names, radii[images] - radii, most


def _find_images(points: np.ndarray) -> np.ndarray:
    """Return the numbers (n,) of the `points` (n, 3) that are nearest to the image of each."""
    return np.linalg.norm(points[None] - (points @ _FLIP)[:, None], axis=2).argmin(axis=1)
