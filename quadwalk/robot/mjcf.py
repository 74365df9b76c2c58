"""Conversion of a checked URDF to an MjSpec, from which MJCF is written and models are compiled.

Links that move become bodies; links that fixed joints attach are fused with them, their inertia
composed exactly and their frames kept as sites of the same name.
"""

from copy import deepcopy
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path

import mujoco
import numpy as np
import yourdfpy

from quadwalk.robot.inertia import SMALLEST, compute_inertia, find_principal, round_moments
from quadwalk.robot.meshes import Meshes, is_inside
from quadwalk.robot.report import Report, UrdfError
from quadwalk.robot.scene import add_home, add_sun, exclude_overlaps, make_spec
from quadwalk.robot.shapes import Shapes, to_pose
from quadwalk.robot.structure.home import compute_standing_pose, find_stated_pose
from quadwalk.robot.structure.legs import Leg
from quadwalk.robot.structure.tree import get_range, is_limited, make_unique, normalize
from quadwalk.robot.urdf import Urdf

FRAME_GROUP = 4  # of the sites that mark frames; MuJoCo's viewer hides 3 and above
FREE_JOINT = "floating_base"
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
_SINGLE = {"revolute": _HINGE, "continuous": _HINGE, "prismatic": _SLIDE}


@dataclass(frozen=True)
class Options:
    """Choices that a URDF leaves to whoever converts it."""

    # whether the root link floats; None: unless it is `world`, or no quadruped's and without mass
    floating: bool | None = None
    meshes: bool = True  # whether mesh files are read; without them, their shapes are left out
    mesh_folders: tuple[Path, ...] = ()  # where they may be, besides the URDF's folder
    # kg m^2 by joint name, over what the URDF says
    armature: dict[str, float] = field(default_factory=dict)
    effort: float | None = None  # N m, of those of a quadruped's motors that the URDF gives none
    speed: float | None = None  # rad/s, the same


@dataclass(frozen=True)
class Conversion:
    """A robot's spec, and notes on how it came about."""

    spec: mujoco.MjSpec
    report: Report


def open_meshes(urdf: Urdf, options: Options, report: Report) -> Meshes:
    """Open the URDF's mesh files where `options` allow; note in `report` what is left out."""
    folders = [folder for folder in (urdf.folder, *options.mesh_folders) if folder]
    if urdf.mesh_folder:
        # As MuJoCo has it, from the URDF's folder; a run's copy of the URDF has that as another.
        mesh_folders = [folder / urdf.mesh_folder for folder in folders]
        folders = [*(f for f in mesh_folders if is_inside(f, folders)), *folders]
    return Meshes(folders if options.meshes else None, urdf.source, report)


def convert(urdf: Urdf, legs: tuple[Leg, ...] = (), options: Options | None = None) -> Conversion:
    """Convert a URDF to a spec of the robot above a floor, with its `home` keyframe, and notes.

    `legs` of a quadruped are in the order that the model's joints and actuators shall have. Without
    them, joints keep the file's order and home is joint position 0. Raise `UrdfError` where a root
    link that shall move freely has no mass or inertia, or where MuJoCo refuses the robot.
    """
    options = options or Options()
    report = deepcopy(urdf.report)
    spec = make_spec()
    spec.modelname = urdf.robot.name
    origin = Path(urdf.source).name.replace("--", "-")
    spec.comment = f"Converted from {origin} by quadwalk.robot: change that, and convert again."
    # All mass is the links' <inertial>: a link without one gets none invented from its shapes.
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    builder = _Builder(spec, urdf, legs, options, report)
    try:
        builder.add_bodies()
        builder.add_followers()
        builder.exclude_neighbors()
        builder.add_motors()
        builder.add_sensors()
        pose = choose_pose(urdf, legs, report) if legs else None
        add_home(spec, pose, [leg.foot_name for leg in legs])
        overlaps = exclude_overlaps(spec)
    except (ValueError, mujoco.FatalError) as error:  # of MuJoCo's compiler: a flat mesh, say
        reason = " ".join(str(error).split())
        raise UrdfError(f"{urdf.source}: MuJoCo does not take this robot: {reason}") from None
    for pair in overlaps:
        report.add("assumed", "never touch, for they overlap in the home pose", pair)
    return Conversion(spec, report)


def choose_pose(urdf: Urdf, legs: tuple[Leg, ...], report: Report) -> np.ndarray:
    """Return the joint angles (12,), rad, of the home pose: as stated, or from geometry."""
    pose = find_stated_pose(urdf.tree, legs, urdf.home)
    if pose is not None:
        return pose
    if urdf.home:
        note = "a home pose from the legs' geometry, for in the file's own it would not stand"
        report.add("assumed", note)
    return compute_standing_pose(urdf.tree, legs)


def write_xml(spec: mujoco.MjSpec) -> str:
    """Return the MJCF of `spec`: always the same, and with 6 digits exact to some 1e-6."""
    spec = spec.copy()
    for body in spec.bodies:
        if body.mass > 0:
            body.inertia = round_moments(body.inertia)
    spec.compile()
    return spec.to_xml()


@dataclass
class _Builder:
    """A robot under construction in a spec."""

    spec: mujoco.MjSpec
    urdf: Urdf
    legs: tuple[Leg, ...]
    options: Options
    report: Report

    def __post_init__(self) -> None:
        self.tree, robot = self.urdf.tree, self.urdf.robot
        self.floating = self._is_floating()
        meshes = open_meshes(self.urdf, self.options, self.report)
        self.shapes = Shapes(self.spec, robot, self.legs, meshes, self.report)
        self.joints: list[yourdfpy.Joint] = []  # of one direction each
        self.joint_names = {joint.name for joint in robot.joints if joint.type != "fixed"}

    def _is_floating(self) -> bool:
        """Return True if the root link gets a free joint; raise `UrdfError` if it lacks mass."""
        root = self.tree.root
        whole = compute_inertia(self.tree, root)
        if self.options.floating is False or (root == "world" and not self.options.floating):
            return False
        if self.options.floating is None and not self.legs and whole is None:
            self.report.add("assumed", "fixed to the ground, for it has no mass", root)
            return False
        if root == "world" or whole is None or whole.mass < SMALLEST:
            raise UrdfError(
                f"{self.urdf.source}: link '{root}' is to float and has no mass; expected "
                "<inertial> with a mass above 0, or a fixed base"
            )
        if find_principal(whole.about_com)[0][2] < SMALLEST:
            raise UrdfError(
                f"{self.urdf.source}: link '{root}' floats, and its <inertia> is not positive "
                "definite; expected principal moments above 0 (or pass --robot.repair-inertia)"
            )
        return True

    def add_bodies(self) -> None:
        """Add a body per moving link, the root's first, parents before children."""
        # A quadruped's legs in their own order, anything else in the file's.
        rank = {leg.links[0]: i for i, leg in enumerate(self.legs)}
        pending = [(self.tree.root, self.spec.worldbody)]
        while pending:
            name, parent = pending.pop()
            body = self._add_body(parent, name)
            joints = self.tree.find_moving_joints(name)
            joints.sort(key=lambda joint: rank.get(joint.child, -1))
            # Past links without mass, whose joints their bodies have as well.
            pending.extend((self.tree.follow_joint(joint), body) for joint in reversed(joints))

    def add_followers(self) -> None:
        """Let joints with a `<mimic>` follow another; one that is fixed stays at 0."""
        moving = {joint.name for joint in self.joints}
        for joint in self.joints:
            mimic = joint.mimic
            if mimic is None:
                continue
            equality = self.spec.add_equality(
                name=joint.name,
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=joint.name,
                name2=mimic.joint if mimic.joint in moving else "",
            )
            factor = 1.0 if mimic.multiplier is None else mimic.multiplier
            equality.data[:2] = [mimic.offset or 0.0, factor]

    def exclude_neighbors(self) -> None:
        """Let bodies that share a joint not touch: their shapes meet at it by design."""
        for name in self.tree.bodies[1:]:
            if not self.tree.is_between_joints(name):
                above = self.tree.body_of[self.tree.find_joints_above(name)[0].parent]
                self.spec.add_exclude(name=f"{above}-{name}", bodyname1=above, bodyname2=name)

    def _add_body(self, parent: mujoco.MjsBody, name: str) -> mujoco.MjsBody:
        """Add the body of moving link (or root) `name`, with joints, inertia, shapes and frames."""
        tree = self.tree
        body = parent if name == "world" else parent.add_body(name=name)
        joints = tree.find_joints_above(name)
        if joints:
            frames = [tree.compute_frame(joint) for joint in joints]
            body.pos, body.quat = to_pose(reduce(np.matmul, frames))
            for i, joint in enumerate(joints):
                # From the joint on to the body, all later joints at 0.
                onwards = reduce(np.matmul, frames[i + 1 :], np.eye(4))
                self._add_joint(body, joint, np.linalg.inv(onwards))
                if joint.child != name:
                    self._note_link_without_mass(joint, name)
        elif self.floating:
            body.add_freejoint(name=make_unique(FREE_JOINT, self.joint_names))
            add_sun(body)
        else:
            add_sun(self.spec.worldbody)
        whole = compute_inertia(tree, name)
        if whole is not None and (joints or self.floating):
            body.explicitinertial = True
            body.mass, body.ipos = whole.mass, whole.com
            body.inertia, body.iquat = find_principal(whole.about_com)
        for part in tree.parts[name]:
            self.shapes.add_link(body, tree, part)
            if part != name:
                self.report.add("fused", "by fixed joints", f"{part} with {name}")
                self._add_site(body, part, tree.placement[part])
        for leg in self.legs:
            if leg.links[2] == name == leg.foot.link:
                # A foot that is no link of its own still has its frame, in the sphere's center.
                frame = np.eye(4)
                frame[:3, 3] = leg.foot.center
                self._add_site(body, leg.foot_name, frame)
        return body

    def _add_site(self, body: mujoco.MjsBody, name: str, frame: np.ndarray) -> None:
        """Mark a frame; a foot's site encloses its sphere, as its touch sensor needs."""
        leg = next((leg for leg in self.legs if leg.foot_name == name), None)
        radius = 0.01
        if leg is not None:
            radius = 1.1 * leg.foot.radius + float(np.linalg.norm(leg.foot.center - frame[:3, 3]))
        pos, quat = to_pose(frame)
        body.add_site(name=name, pos=pos, quat=quat, group=FRAME_GROUP, size=[radius] * 3)

    def _note_link_without_mass(self, joint: yourdfpy.Joint, name: str) -> None:
        """Note that a joint moves body `name` over a link without mass, which is no body."""
        self.report.add("fused", "joints over links without mass", f"{joint.name} with {name}")
        for part in self.tree.parts[joint.child]:
            if self.tree.links[part].visuals:
                self.report.add("dropped", "visual shapes of links without mass", part)

    def _add_joint(self, body: mujoco.MjsBody, joint: yourdfpy.Joint, frame: np.ndarray) -> None:
        """Add a joint to the body that it moves; `frame` (4, 4) is its own there, joints at 0."""
        if joint.type in _SINGLE:
            self._add_single(body, joint, frame)
            self.joints.append(joint)
            return
        self._add_several(body, joint)
        self.report.add("assumed", f"no motor, for it is {joint.type}", joint.name)
        if joint.dynamics is not None or joint.limit is not None:
            self.report.add("dropped", "limits and dynamics of several directions", joint.name)

    def _add_single(self, body: mujoco.MjsBody, joint: yourdfpy.Joint, frame: np.ndarray) -> None:
        """Add a joint of one direction, with its limits, damping, friction and armature."""
        added = body.add_joint(
            name=joint.name,
            type=_SINGLE[joint.type],
            axis=frame[:3, :3] @ normalize(joint.axis),
            pos=frame[:3, 3],
        )
        if is_limited(joint):
            added.range = get_range(joint)
        if joint.limit is not None and 0 < joint.limit.effort < np.inf:
            added.actfrcrange = [-joint.limit.effort, joint.limit.effort]
        if joint.limit is not None and joint.limit.velocity < np.inf:
            # MuJoCo knows no largest speed: it is kept as the joint's user datum.
            added.userdata = [joint.limit.velocity]
        if joint.dynamics is not None:
            added.damping[0] = float(joint.dynamics.damping or 0)
            added.frictionloss = float(joint.dynamics.friction or 0)
        armature = {**self.urdf.armature, **self.options.armature}
        added.armature = armature.get(joint.name, 0.0)

    def _add_several(self, body: mujoco.MjsBody, joint: yourdfpy.Joint) -> None:
        """Add the MuJoCo joints that make up a `planar` or `floating` joint JOINT, without limits.

        Planar: slides JOINT_x and JOINT_y across the axis, then hinge JOINT_turn about it. The
        slides are along the joint frame's x and y where the axis is its z; for another axis both
        are turned by the smallest rotation that takes z to the axis. Floating: slides JOINT_x,
        JOINT_y and JOINT_z along the joint frame's axes, then ball JOINT_ball. (MuJoCo allows a
        free joint only in a child of the world.)
        """
        if joint.type == "planar":
            x, y, z = _turn_axes(normalize(joint.axis))
            parts = [("x", _SLIDE, x), ("y", _SLIDE, y), ("turn", _HINGE, z)]
        else:
            x, y, z = np.eye(3)
            ball = mujoco.mjtJoint.mjJNT_BALL
            parts = [("x", _SLIDE, x), ("y", _SLIDE, y), ("z", _SLIDE, z), ("ball", ball, z)]
        for suffix, kind, axis in parts:
            name = make_unique(f"{joint.name}_{suffix}", self.joint_names)
            self.joint_names.add(name)
            body.add_joint(name=name, type=kind, axis=axis)

    def add_motors(self) -> None:
        """Add a motor per joint, named after it, of gear 1 and within the effort limit."""
        for joint in self.joints:
            if joint.mimic is not None:
                continue
            if joint.limit is not None and joint.limit.effort == 0:
                self.report.add("assumed", "no motor, for the effort is 0", joint.name)
                continue
            motor = self.spec.add_actuator(
                name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            motor.set_to_motor()
            if joint.limit is None:
                self.report.add("assumed", "any effort, for there is no <limit>", joint.name)
            elif joint.limit.effort < np.inf:
                motor.ctrlrange = [-joint.limit.effort, joint.limit.effort]

    def add_sensors(self) -> None:
        """Add touch sensors in feet, and a floating robot's gyro, accelerometer and orientation."""
        kinds = mujoco.mjtSensor
        if self.floating:
            root = self.tree.root
            site = next((name for name in self.tree.parts[root][1:] if "imu" in name.lower()), None)
            if site is None:
                site = make_unique("imu", self.tree.links)
                self._add_site(self.spec.body(root), site, np.eye(4))
                self.report.add("assumed", "the IMU's frame, for no link is named so", root)
            for name, kind in (
                ("imu_gyro", kinds.mjSENS_GYRO),
                ("imu_accelerometer", kinds.mjSENS_ACCELEROMETER),
                ("imu_orientation", kinds.mjSENS_FRAMEQUAT),
            ):
                self._add_sensor(name, kind, site)
        for leg in self.legs:
            self._add_sensor(f"{leg.foot_name}_touch", kinds.mjSENS_TOUCH, leg.foot_name)

    def _add_sensor(self, name: str, kind: mujoco.mjtSensor, site: str) -> None:
        self.spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)


def _turn_axes(axis: np.ndarray) -> np.ndarray:
    """Turn the axes x, y and z, rows of (3, 3), the shortest way that takes z to `axis`."""
    turn, rows = np.zeros(4), np.zeros((3, 3))
    mujoco.mju_quatZ2Vec(turn, axis)
    for row, standard in zip(rows, np.eye(3), strict=True):
        mujoco.mju_rotVecQuat(row, standard, turn)
    return rows
