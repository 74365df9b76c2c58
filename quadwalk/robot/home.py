"""The `home` keyframe: joints in the standing pose, the lowest point just on the ground."""

import mujoco
import numpy as np

HOME = "home"
_Type = mujoco.mjtGeom


def add_home(spec: mujoco.MjSpec, pose: np.ndarray | None, feet: list[str]) -> None:
    """Add the keyframe `home`.

    Args:
        spec: with all bodies, and collision geoms that are named.
        pose: joint positions in the model's order, rad; None for 0 or the limit nearest to it.
        feet: names of the geoms to stand on; without any, the lowest shape is.
    """
    model = spec.compile()
    floating = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    qpos = model.qpos0.copy()
    if pose is not None:
        qpos[7:] = pose
    else:
        limited = model.jnt_limited.astype(bool)
        qpos[model.jnt_qposadr[limited]] = np.clip(0, *model.jnt_range[limited].T)
    for row in range(model.neq):  # a joint that follows another
        follower, leader = model.eq_obj1id[row], model.eq_obj2id[row]
        offset, factor = model.eq_data[row, :2]
        at = model.jnt_qposadr
        qpos[at[follower]] = offset + factor * qpos[at[leader]]
    if floating:
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        shapes = [model.geom(foot).id for foot in feet] or np.flatnonzero(model.geom_bodyid > 0)
        qpos[2] -= min((lowest_point(model, data, int(geom)) for geom in shapes), default=0.0)
    spec.add_key(name=HOME, qpos=qpos)


def exclude_overlaps(spec: mujoco.MjSpec) -> list[str]:
    """Let no contact happen between bodies that already overlap in the home pose.

    Returns the pairs, for the report. A floating robot's contact with the floor stays.
    """
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    floating = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    overlapping = {
        tuple(sorted(model.geom_bodyid[contact.geom]))
        for contact in data.contact
        if contact.dist < 0 and (not floating or model.geom_bodyid[contact.geom].all())
    }
    pairs = [(model.body(a).name, model.body(b).name) for a, b in sorted(overlapping)]
    for first, second in pairs:
        spec.add_exclude(name=f"{first}-{second}", bodyname1=first, bodyname2=second)
    return [f"'{first}' and '{second}'" for first, second in pairs]


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height (m, world z) of the lowest point of a geom, from `data`'s current kinematics."""
    size = model.geom_size[geom]
    # The direction `down` in the geom's own axes: the shape's extent along it is its support.
    down = -data.geom_xmat[geom].reshape(3, 3)[2]
    kind = model.geom_type[geom]
    if kind == _Type.mjGEOM_SPHERE:
        extent = size[0]
    elif kind == _Type.mjGEOM_BOX:
        extent = np.abs(down) @ size
    elif kind == _Type.mjGEOM_CYLINDER:
        extent = size[0] * np.hypot(down[0], down[1]) + size[1] * abs(down[2])
    elif kind == _Type.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        extent = np.max(vertices @ down)
    else:
        raise AssertionError(f"no URDF shape becomes a geom of type {kind}")
    return float(data.geom_xpos[geom, 2] - extent)
