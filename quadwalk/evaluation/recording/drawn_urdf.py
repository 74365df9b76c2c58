"""The URDF of a recording: what viewers draw from its text alone.

A viewer does not find the mesh files that a URDF names: what they show is drawn as the shapes that
MuJoCo has in their place.
"""

import lxml.etree
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from quadwalk.robot.shapes import COLLISION_GROUP
from quadwalk.robot.urdf import parse_urdf

_COLOR = "0.6 0.62 0.66 1"


def draw_urdf(urdf: str, model: mujoco.MjModel) -> str:
    """Return `urdf` with shapes that need no file, of each link visual ones or those that collide.

    Rerun would draw both. `model` is the robot's full model.
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
    """Draw all links of a body as its shapes in `model` where one of them has a mesh."""
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
    for shape in link.findall(kind):
        link.remove(shape)


def _make_visual(model: mujoco.MjModel, geom: int) -> lxml.etree._Element:
    """Return a <visual> of a shape in its body's frame; what is no sphere or cylinder is a box."""
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
    return " ".join(f"{x:.6g}" for x in np.round(numbers, 9) + 0.0)
