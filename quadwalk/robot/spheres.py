"""Spheres for a training model in which more than feet touch the floor.

The physics of training lets one sphere of each kind of each leg touch it. Besides the feet, these
stand for what else meets the floor as a robot goes down: its knees and the trunk's lower corners.
"""

import mujoco
import numpy as np

from quadwalk.robot.legs import LEGS
from quadwalk.robot.validate import UrdfError

KNEES, CORNERS = (tuple(f"{kind}_{leg}" for leg in LEGS) for kind in ("knee", "corner"))  # geoms
GROUP = 4  # theirs; those of group 3 are the collision shapes, to be measured
CORNER_RADIUS = 0.01  # m


def add_spheres(
    spec: mujoco.MjSpec, trunk: str, feet: tuple[str, ...], calf_joints: tuple[str, ...]
) -> None:
    """Add `KNEES` and `CORNERS`, which meet the floor as the leg's foot does.

    A knee is centred on the calf's joint and carried by the thigh, as thick as that is there. A
    corner touches from within the box around the trunk's collision shapes, at its bottom.
    `spec` has no other geoms than collision shapes.
    """
    model = spec.compile()
    low, high = _box_around(model, model.body(trunk).id)
    for i, leg in enumerate(LEGS):
        foot = spec.geom(feet[i])
        calf = model.joint(calf_joints[i]).bodyid[0]
        thigh, knee = model.body_parentid[calf], model.body_pos[calf]
        radius = min(_thickness(model, thigh, knee), foot.size[0])
        _add(spec, model.body(thigh).name, KNEES[i], knee, radius, foot)
        ahead, left = leg[0] == "F", leg[1] == "L"
        corner = np.where([ahead, left, False], high - CORNER_RADIUS, low + CORNER_RADIUS)
        _add(spec, trunk, CORNERS[i], corner, CORNER_RADIUS, foot)


def _add(spec, body, name, centre, radius, foot) -> None:
    spec.body(body).add_geom(
        foot.classname,
        name=name,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        pos=centre,
        size=[radius, 0, 0],
        group=GROUP,
        contype=foot.contype,
        conaffinity=foot.conaffinity,
        friction=foot.friction,
    )


def _box_around(model: mujoco.MjModel, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,), m, of the box around a body's shapes, in its frame."""
    boxes = _boxes(model, body)
    if not boxes:
        raise UrdfError(
            f"link '{model.body(body).name}' has no collision shape; contacts 'body' expect one, "
            "for it is to touch the floor"
        )
    reaches = [(centre, np.abs(rotation) @ half) for centre, rotation, half in boxes]
    low = np.min([centre - reach for centre, reach in reaches], axis=0)
    return low, np.max([centre + reach for centre, reach in reaches], axis=0)


def _thickness(model: mujoco.MjModel, thigh: int, knee: np.ndarray) -> float:
    """Half the thickness, m, of the thigh's shape that is nearest to `knee` (3,); inf for none."""
    found = [(0.0, np.inf)]
    for centre, rotation, half in _boxes(model, thigh):
        beyond = np.maximum(np.abs((knee - centre) @ rotation) - half, 0)
        found.append((float(np.linalg.norm(beyond)), float(np.sort(half)[1])))
    return min(found)[1]


def _boxes(model: mujoco.MjModel, body: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of each of a body's shapes the box around it: centre, axes as columns, half its sides, m."""
    boxes = []
    for geom in np.flatnonzero(model.geom_bodyid == body):
        entries = np.zeros(9)
        mujoco.mju_quat2Mat(entries, model.geom_quat[geom])
        rotation = entries.reshape(3, 3)
        centre, half = np.split(model.geom_aabb[geom], 2)
        boxes.append((model.geom_pos[geom] + rotation @ centre, rotation, half))
    return boxes
