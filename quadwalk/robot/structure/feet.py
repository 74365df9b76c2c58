"""A leg's foot: the sphere at its end, or one that stands in for another shape there."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import yourdfpy

from quadwalk.robot.meshes import Meshes
from quadwalk.robot.structure.tree import Capsule, Tree, normalize, to_matrix

# Share of the distance from calf joint to foot that the tip of a shape is taken from, and the
# least and the assumed radius of a foot.
TIP, LEAST, ASSUMED = 0.15, 0.01, 0.08
# A shape of the calf's own link that reaches over less than this share of that is the foot's.
SHORT = 0.4


@dataclass(frozen=True)
class Foot:
    """A foot: a sphere."""

    link: str  # whose collision shape touches the ground
    # index among the link's collision shapes; None: it is none of them, but stands in for another
    shape: int | None
    center: np.ndarray  # (3,) m, in the frame of the calf link
    radius: float  # m
    replaced: tuple[int, ...] = ()  # indices of the link's collision shapes whose place it takes
    reason: str = ""  # of a sphere that is none of the URDF's, what it is there for


@dataclass(frozen=True)
class _Shape:
    """A shape of a leg's last body: its link, index, and points (n, 3), m, in the calf's frame."""

    link: str
    index: int
    points: np.ndarray


def find_foot(tree: Tree, calf: str, meshes: Meshes | None) -> Foot | None:
    """Return the foot, a sphere, of the leg whose last moving link is `calf`; None without any.

    The collision sphere farthest from the calf's joint is the foot. Without one, a sphere takes
    the place of the shape that reaches farthest: it has the shape's lowest point, along the leg,
    and its width there, in the plane the calf swings in. Without shapes, it is a small sphere at
    the farthest link that is fixed to the calf. Without `meshes`, mesh shapes do not count.
    """
    return _find_sphere(tree, calf) or _fit_sphere(tree, calf, meshes) or _assume_sphere(tree, calf)


def _find_sphere(tree: Tree, calf: str) -> Foot | None:
    """Return the collision sphere that is farthest from the calf's joint."""
    spheres = [
        Foot(link, index, center, shape.geometry.sphere.radius)
        for link in tree.parts[calf]
        for index, shape in enumerate(tree.links[link].collisions)
        if shape.geometry.sphere is not None
        for center in [(tree.placement[link] @ to_matrix(shape.origin))[:3, 3]]
    ]
    # One nearer to the joint than half a thigh's length is a knee.
    thigh = float(np.linalg.norm(to_matrix(tree.joint_above[calf].origin)[:3, 3]))
    ends = [foot for foot in spheres if np.linalg.norm(foot.center) > thigh / 2]
    return max(ends, key=lambda foot: float(np.linalg.norm(foot.center)), default=None)


def _fit_sphere(tree: Tree, calf: str, meshes: Meshes | None) -> Foot | None:
    """Return a sphere in the end of the shape that reaches farthest, one seen if none collides."""
    shapes = list(_list_shapes(tree, calf, meshes, "collision"))
    collides = bool(shapes)
    shapes = shapes or list(_list_shapes(tree, calf, meshes, "visual"))
    if not shapes:
        return None
    points = np.concatenate([shape.points for shape in shapes])
    distance = np.linalg.norm(points, axis=1)
    axis = normalize(tree.joint_above[calf].axis)
    along = points[distance > 0.8 * distance.max()].mean(axis=0)
    along -= axis * (axis @ along)
    if np.linalg.norm(along) < 1e-6:
        return None
    along /= np.linalg.norm(along)
    across = np.cross(axis, along)
    lowest = max(shapes, key=lambda shape: float((shape.points @ along).max()))
    parts = [s for s in shapes if s.link == lowest.link] if lowest.link != calf else [lowest]
    points = np.concatenate([shape.points for shape in parts])
    reach = float((points @ along).max())
    tip = points[points @ along >= (1 - TIP) * reach]
    length = np.ptp(points @ along)
    radius = max(min(np.ptp(tip @ across), length) / 2, LEAST * reach)
    center = along * (reach - radius)
    for direction in (across, axis):
        center = center + direction * ((tip @ direction).max() + (tip @ direction).min()) / 2
    replaces = collides and (lowest.link != calf or length < SHORT * reach)
    return Foot(
        link=lowest.link,
        shape=None,
        center=center,
        radius=float(radius),
        replaced=tuple(shape.index for shape in parts) if replaces else (),
        reason="in place of other shapes" if replaces else "at the ends of the calves' shapes",
    )


def _assume_sphere(tree: Tree, calf: str) -> Foot | None:
    """Return a small sphere at the frame that is farthest from the calf's joint."""
    frames = [(tree.placement[link][:3, 3], link) for link in tree.parts[calf][1:]]
    if not frames:
        return None
    center, link = max(frames, key=lambda frame: float(np.linalg.norm(frame[0])))
    reach = float(np.linalg.norm(center))
    if reach < 1e-3:
        return None
    return Foot(link, None, center, ASSUMED * reach, reason="at frames, for there are no shapes")


def _list_shapes(tree: Tree, calf: str, meshes: Meshes | None, kind: str) -> Iterator[_Shape]:
    for link in tree.parts[calf]:
        shapes = tree.links[link].collisions if kind == "collision" else tree.links[link].visuals
        for index, shape in enumerate(shapes):
            points = _sample_outline(shape.geometry, meshes, kind)
            if len(points):
                frame = tree.placement[link] @ to_matrix(shape.origin)
                yield _Shape(link, index, points @ frame[:3, :3].T + frame[:3, 3])


def _sample_outline(geometry: yourdfpy.Geometry, meshes: Meshes | None, kind: str) -> np.ndarray:
    """Return points (n, 3), m, on the outline of a shape, in its own frame."""
    if geometry.box is not None:
        return np.array(list(product((-0.5, 0.5), repeat=3))) * geometry.box.size
    if geometry.cylinder is not None:
        turns = np.linspace(0, 2 * np.pi, 32, endpoint=False)
        radius, half = geometry.cylinder.radius, geometry.cylinder.length / 2
        ring = np.stack([radius * np.cos(turns), radius * np.sin(turns), half + 0 * turns], axis=1)
        rings = [ring]
        if isinstance(geometry.cylinder, Capsule):
            for latitude in np.linspace(0, np.pi / 2, 7)[1:]:
                rim = radius * np.sin(latitude)
                rings.append(ring * [np.cos(latitude), np.cos(latitude), 1] + [0, 0, rim])
        points = np.concatenate(rings)
        return np.concatenate([points, points * [1, 1, -1]])
    if geometry.sphere is not None:
        return geometry.sphere.radius * np.concatenate([np.eye(3), -np.eye(3)])
    loaded = None if meshes is None else meshes.load(geometry.mesh, kind)
    if loaded is None:
        return np.zeros((0, 3))
    return np.concatenate([part.vertices for part in loaded[1]])
