"""Conversion of a checked URDF to an MjSpec, from which MJCF is written and models are compiled.

Links that move become bodies; links that fixed joints attach are fused with them, their inertia
composed exactly and their frames kept as sites of the same name.
"""

import mujoco
import numpy as np
import yourdfpy

from quadwalk.robot import inertia
from quadwalk.robot.legs import Leg, joint_range, standing_pose, unit
from quadwalk.robot.scene import FRICTION, add_scene, add_sun
from quadwalk.robot.tree import Tree, build_tree, matrix
from quadwalk.robot.urdf import Urdf

VISUAL, COLLISION, FRAMES = 2, 3, 4  # geom and site groups; MuJoCo's viewer hides 3 and above
HOME = "home"
FREE_JOINT = "floating_base"

_Type = mujoco.mjtGeom
_JOINT_TYPES = {
    "revolute": mujoco.mjtJoint.mjJNT_HINGE,
    "continuous": mujoco.mjtJoint.mjJNT_HINGE,
    "prismatic": mujoco.mjtJoint.mjJNT_SLIDE,
}


def build_spec(urdf: Urdf, legs: tuple[Leg, ...] | None = None) -> mujoco.MjSpec:
    """The robot on a floating base above a floor, with its `home` keyframe.

    Args:
        urdf: what `read_urdf` returned.
        legs: for a quadruped, its legs in the order that the model's joints and actuators shall
            have; without them, joints keep the file's order and home is joint position 0.
    """
    tree = build_tree(urdf.robot)
    spec = mujoco.MjSpec()
    spec.modelname = urdf.robot.name or "robot"
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    # All mass is the links' <inertial>: a link without one gets none invented from its shapes.
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.timestep = 0.002
    add_scene(spec)
    _add_defaults(spec)
    _add_materials(spec, urdf.robot)
    order = {leg.links[0]: rank for rank, leg in enumerate(legs or ())}
    builder = _Builder(spec, tree, urdf, legs or ())
    pending = [(tree.root, spec.worldbody)]
    while pending:
        name, parent = pending.pop()
        body = builder.add_body(parent, name)
        below = sorted(tree.moving_joints(name), key=lambda joint: order.get(joint.child, -1))
        pending.extend((joint.child, body) for joint in reversed(below))
    builder.add_actuators()
    builder.add_sensors()
    _exclude_neighbours(spec, tree)
    pose = standing_pose(tree, legs, urdf.source) if legs else None
    _add_home(spec, pose, [leg.foot for leg in legs or ()])
    _exclude_overlaps(spec)
    return spec


def write_xml(spec: mujoco.MjSpec) -> str:
    """The MJCF text of `spec`; the same spec gives the same text."""
    spec.compile()
    return spec.to_xml()


class _Builder:
    """The spec under construction, and what its parts need to know of each other."""

    def __init__(self, spec: mujoco.MjSpec, tree: Tree, urdf: Urdf, legs: tuple[Leg, ...]):
        self.spec, self.tree, self.urdf = spec, tree, urdf
        self.feet = {(leg.foot_link, leg.foot_shape): leg for leg in legs}
        self.legs = legs
        self.materials = {m.name for m in urdf.robot.materials if m.name}
        self.geom_names: set[str] = {leg.foot for leg in legs} | {"floor"}
        self.joints: list[yourdfpy.Joint] = []

    def add_body(self, parent: mujoco.MjsBody, name: str) -> mujoco.MjsBody:
        """Add the body of moving link (or root) `name`, with all that is fused with it."""
        tree = self.tree
        body = parent.add_body(name=name)
        joint = tree.joint_above.get(name)
        if joint is None:
            body.add_freejoint(name=FREE_JOINT)
            add_sun(body)
        else:
            body.pos, body.quat = _pose(tree.frame_of(joint))
            self._add_joint(body, joint)
        links = [(tree.links[link], tree.placement[link]) for link in tree.parts[name]]
        parts = [inertia.link_inertia(link, placement) for link, placement in links]
        whole = inertia.compose([part for part in parts if part is not None])
        if whole is not None:
            body.explicitinertial = True
            body.mass, body.ipos = whole.mass, whole.com
            body.inertia, body.iquat = inertia.principal(whole.about_com)
        for link, placement in links:
            for visual in link.visuals:
                self._add_visual(body, visual, placement)
            for index, collision in enumerate(link.collisions):
                self._add_collision(body, link, index, collision, placement)
            if link.name != name:
                pos, quat = _pose(placement)
                leg = next((leg for leg in self.legs if leg.foot_link == link.name), None)
                body.add_site(name=link.name, pos=pos, quat=quat, **_site_look(leg))
        for leg in self.legs:
            # A foot that is no link of its own still has its frame: the sphere's centre.
            if leg.links[2] == name == leg.foot_link:
                body.add_site(name=leg.foot, pos=leg.centre, **_site_look(leg))
        return body

    def _add_joint(self, body: mujoco.MjsBody, joint: yourdfpy.Joint) -> None:
        added = body.add_joint(
            name=joint.name, type=_JOINT_TYPES[joint.type], axis=unit(joint.axis)
        )
        if joint.type != "continuous":
            added.range = joint_range(joint)
        if joint.limit is not None and joint.limit.effort is not None:
            added.actfrcrange = [-joint.limit.effort, joint.limit.effort]
        if joint.dynamics is not None:
            added.damping[0] = float(joint.dynamics.damping or 0)
            added.frictionloss = float(joint.dynamics.friction or 0)
        added.armature = self.urdf.armature.get(joint.name, 0.0)
        self.joints.append(joint)

    def _add_visual(self, body, visual, placement) -> None:
        shape = _shape(visual.geometry)
        if shape is None:
            return
        pos, quat = _pose(placement @ matrix(visual.origin))
        geom = body.add_geom(
            self.spec.find_default("visual"), type=shape[0], size=shape[1], pos=pos, quat=quat
        )
        material = visual.material
        if material is not None and material.name in self.materials:
            geom.material = material.name
        elif material is not None and material.color is not None:
            geom.rgba = material.color.rgba

    def _add_collision(self, body, link, index, collision, placement) -> None:
        shape = _shape(collision.geometry)
        if shape is None:
            return
        leg = self.feet.get((link.name, index))
        pos, quat = _pose(placement @ matrix(collision.origin))
        body.add_geom(
            self.spec.find_default("collision" if leg is None else "foot"),
            name=leg.foot if leg else self._geom_name(link.name),
            type=shape[0],
            size=shape[1],
            pos=pos,
            quat=quat,
        )

    def _geom_name(self, link: str) -> str:
        name, count = link, 1
        while name in self.geom_names:
            count += 1
            name = f"{link}_{count}"
        self.geom_names.add(name)
        return name

    def add_actuators(self) -> None:
        """One torque motor per joint, within the effort limit, named after its joint."""
        for joint in self.joints:
            actuator = self.spec.add_actuator(
                name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            actuator.set_to_motor()
            if joint.limit is not None and joint.limit.effort is not None:
                actuator.ctrlrange = [-joint.limit.effort, joint.limit.effort]

    def add_sensors(self) -> None:
        """An IMU (gyro, accelerometer, orientation) and a touch sensor per foot."""
        site = next(
            (n for n in self.tree.links if "imu" in n.lower() and n != self.tree.root), None
        )
        if site is None:
            site = "imu"
            self.spec.body(self.tree.root).add_site(name=site, **_site_look(None))
        kinds = mujoco.mjtSensor
        for name, kind in (
            ("imu_gyro", kinds.mjSENS_GYRO),
            ("imu_accelerometer", kinds.mjSENS_ACCELEROMETER),
            ("imu_orientation", kinds.mjSENS_FRAMEQUAT),
        ):
            self.spec.add_sensor(
                name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site
            )
        for leg in self.legs:
            self.spec.add_sensor(
                name=f"{leg.foot}_touch",
                type=kinds.mjSENS_TOUCH,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=leg.foot,
            )


def _add_defaults(spec: mujoco.MjSpec) -> None:
    visual = spec.add_default("visual", spec.default)
    visual.geom.contype = visual.geom.conaffinity = 0
    visual.geom.group = VISUAL
    collision = spec.add_default("collision", spec.default)
    collision.geom.group = COLLISION
    collision.geom.friction = [FRICTION, 0.005, 0.0001]
    collision.geom.rgba = [0.9, 0.3, 0.3, 0.5]
    foot = spec.add_default("foot", collision)
    # Sliding friction only: a small hard foot has next to no torsional or rolling friction.
    foot.geom.condim = 3


def _add_materials(spec: mujoco.MjSpec, robot: yourdfpy.Robot) -> None:
    for material in robot.materials:
        if material.name and material.color is not None:
            spec.add_material(
                name=material.name, rgba=material.color.rgba, specular=0.3, shininess=0.4
            )


def _shape(geometry: yourdfpy.urdf.Geometry) -> tuple[mujoco.mjtGeom, list[float]] | None:
    """MuJoCo's geom type and size (m) of a primitive; None for a mesh."""
    if geometry.box is not None:
        return _Type.mjGEOM_BOX, [side / 2 for side in geometry.box.size]
    if geometry.sphere is not None:
        return _Type.mjGEOM_SPHERE, [geometry.sphere.radius, 0, 0]
    if geometry.cylinder is not None:
        return _Type.mjGEOM_CYLINDER, [geometry.cylinder.radius, geometry.cylinder.length / 2, 0]
    return None


def _site_look(leg: Leg | None) -> dict:
    """A foot's site encloses its sphere, as touch sensors need; the others only mark a frame."""
    radius = 1.1 * leg.radius if leg else 0.01
    return {"group": FRAMES, "size": [radius] * 3}


def _pose(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and quaternion wxyz (4,) of a (4, 4) frame."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, frame[:3, :3].ravel())
    return frame[:3, 3], quat


def _exclude_neighbours(spec: mujoco.MjSpec, tree: Tree) -> None:
    """No contact between bodies that share a joint: their shapes meet at it by design."""
    for body in tree.bodies[1:]:
        parent = tree.body_of[tree.joint_above[body].parent]
        spec.add_exclude(name=f"{parent}-{body}", bodyname1=parent, bodyname2=body)


def _exclude_overlaps(spec: mujoco.MjSpec) -> None:
    """No contact between other bodies that already overlap in the home pose."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    overlapping = {
        tuple(sorted(model.geom_bodyid[contact.geom]))
        for contact in data.contact
        if contact.dist < 0 and model.geom_bodyid[contact.geom].all()
    }
    for first, second in sorted(overlapping):
        first, second = model.body(first).name, model.body(second).name
        spec.add_exclude(name=f"{first}-{second}", bodyname1=first, bodyname2=second)


def _add_home(spec: mujoco.MjSpec, pose: np.ndarray | None, feet: list[str]) -> None:
    """The keyframe `home`: the joints at `pose` and the lowest foot (or shape) just at height 0."""
    model = spec.compile()
    qpos = model.qpos0.copy()
    if pose is not None:
        qpos[7:] = pose
    else:
        limited = model.jnt_limited.astype(bool)
        qpos[model.jnt_qposadr[limited]] = np.clip(0, *model.jnt_range[limited].T)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    shapes = [model.geom(foot).id for foot in feet] or [
        geom for geom in range(model.ngeom) if model.geom_bodyid[geom] > 0
    ]
    if shapes:
        qpos[2] -= min(lowest_point(model, data, geom) for geom in shapes)
    spec.add_key(name=HOME, qpos=qpos)


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height (m, world z) of the lowest point of a geom, from `data`'s current kinematics."""
    size = model.geom_size[geom]
    # The direction `down` in the geom's own axes: its extent along it is the shape's support.
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
