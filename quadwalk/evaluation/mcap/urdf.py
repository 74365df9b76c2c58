"""The URDF of a recording: viewers draw the robot from its text, and from its links' transforms.

A viewer does not find the mesh files that a URDF names: what they show is drawn as the shapes that
MuJoCo has in their place. The transforms are those from link to link of the URDF's own tree, fixed
links included. Quaternions are wxyz.
"""

from dataclasses import dataclass
from functools import lru_cache

import lxml.etree
import mujoco
import numpy as np
import yourdfpy
from scipy.spatial.transform import Rotation

from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.scene import COLLISION_GROUP
from quadwalk.robot.structure.tree import to_matrix
from quadwalk.robot.urdf import parse_urdf

_COLOR = "0.6 0.62 0.66 1"


def draw_urdf(urdf: str, model: mujoco.MjModel) -> str:
    """Return `urdf` with shapes that need no file: those of `model` in place of meshes.

    Links with visual shapes lose the others: Rerun would draw collision shapes too. `model` is the
    robot's full model.
    """
    root = lxml.etree.fromstring(urdf.encode())
    links = {link.get("name"): link for link in root.iter("link")}
    for link in links.values():
        if link.find("visual") is not None:
            _remove(link, "collision")
    if root.find("link//mesh") is not None:
        _replace_meshes(links, urdf, model)
    return lxml.etree.tostring(root, encoding="unicode")


def _replace_meshes(
    links: dict[str | None, lxml.etree._Element], urdf: str, model: mujoco.MjModel
) -> None:
    """Replace the shapes of every body of which a link has a mesh by its shapes in `model`.

    `links` are the elements of all links of the text `urdf`, by name. They are changed in place:
    the shapes go from all links of such a body, and the link that it is named after gets a visual
    for each shape in `model`.
    """
    tree = parse_urdf(urdf, repair_inertia=True).tree
    for body, parts in tree.parts.items():
        if all(links[part].find(".//mesh") is None for part in parts):
            continue
        for part in parts:
            _remove(links[part], "visual")
            _remove(links[part], "collision")
        # A link without mass is no body, and has no shapes that count.
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
        geoms = np.flatnonzero(model.geom_bodyid == index)
        colliding = geoms[model.geom_group[geoms] == COLLISION_GROUP]
        for geom in colliding if len(colliding) else geoms:
            links[body].append(_make_visual(model, int(geom)))


def _remove(link: lxml.etree._Element, kind: str) -> None:
    """Remove all shapes of this kind, "visual" or "collision", from a link."""
    for shape in link.findall(kind):
        link.remove(shape)


def _make_visual(model: mujoco.MjModel, geom: int) -> lxml.etree._Element:
    """Return a <visual> of a geom in its body's frame: a sphere, a cylinder or its bounding box."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    turn = Rotation.from_quat(model.geom_quat[geom], scalar_first=True)
    place = model.geom_pos[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        shape = f'<sphere radius="{size[0]:.6g}"/>'
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        shape = f'<cylinder radius="{size[0]:.6g}" length="{2 * size[1]:.6g}"/>'
    else:
        center, half = np.split(model.geom_aabb[geom], 2)
        place = place + turn.apply(center)
        shape = f'<box size="{_to_text(2 * half)}"/>'
    rpy = turn.as_euler("xyz", suppress_warnings=True)
    return lxml.etree.fromstring(
        f'<visual><origin xyz="{_to_text(place)}" rpy="{_to_text(rpy)}"/>'
        f"<geometry>{shape}</geometry>"
        f'<material name="recorded_shapes"><color rgba="{_COLOR}"/></material></visual>'
    )


def _to_text(numbers: np.ndarray) -> str:
    """Return numbers as the value of a URDF's attribute, without -0."""
    return " ".join(f"{x:.6g}" for x in np.round(numbers, 9) + 0.0)


@dataclass(frozen=True)
class LinkFrames:
    """Frames of a URDF's links but the root, each in its parent's frame; parents come first."""

    links: tuple[str, ...]
    parents: tuple[str, ...]
    translation: np.ndarray  # (L, 3) m
    rotation: np.ndarray  # (L, 4) at joint position 0
    axis: np.ndarray  # (L, 3) unit, in the link's own frame; zero for a fixed link
    column: np.ndarray  # (L,) of the joint positions; 0 for a fixed link

    def compute_rotations(self, joints: np.ndarray) -> np.ndarray:
        """Return the orientations (T, L, 4), wxyz, of the links in their parents' frames.

        `joints` (T, 12), rad, are the joints' positions.
        """
        turn = joints[:, self.column, None] * self.axis
        fixed = Rotation.from_quat(np.tile(self.rotation, (len(joints), 1)), scalar_first=True)
        rotations = fixed * Rotation.from_rotvec(turn.reshape(-1, 3))
        return rotations.as_quat(scalar_first=True).reshape(*turn.shape[:2], 4)


@lru_cache(maxsize=1)  # an evaluation asks for one robot's with every recording
def find_link_frames(quadruped: Quadruped) -> LinkFrames:
    """Return the frames of the links of a quadruped's URDF; only the legs' joints turn."""
    tree = parse_urdf(quadruped.urdf, repair_inertia=True).tree
    joints: list[yourdfpy.Joint] = []
    pending = [tree.root]
    while pending:
        below = tree.joints_below[pending.pop(0)]
        joints += below
        pending += [joint.child for joint in below]
    column = {name: k for k, name in enumerate(quadruped.joints)}
    frames = np.array([to_matrix(joint.origin) for joint in joints])
    axes = np.zeros((len(joints), 3))
    for axis, joint in zip(axes, joints, strict=True):
        if joint.name in column:
            axis[:] = [1.0, 0.0, 0.0] if joint.axis is None else joint.axis
            axis /= np.linalg.norm(axis)
    return LinkFrames(
        links=tuple(joint.child for joint in joints),
        parents=tuple(joint.parent for joint in joints),
        translation=frames[:, :3, 3],
        rotation=Rotation.from_matrix(frames[:, :3, :3]).as_quat(scalar_first=True),
        axis=axes,
        column=np.array([column.get(joint.name, 0) for joint in joints]),
    )
