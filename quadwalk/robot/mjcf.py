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

from quadwalk.robot.checks.validate import UrdfError
from quadwalk.robot.elements import (
    SINGLE,
    Shapes,
    add_geom_classes,
    add_several,
    add_single,
    pose,
    unique,
)
from quadwalk.robot.inertia import SMALLEST, body_inertia, principal, printable
from quadwalk.robot.meshes import Meshes, is_inside
from quadwalk.robot.report import Report
from quadwalk.robot.scene import add_home, add_scene, add_sun, exclude_overlaps
from quadwalk.robot.structure.home import standing_pose
from quadwalk.robot.structure.legs import Leg
from quadwalk.robot.urdf import Urdf

FRAMES = 4  # the group of the sites that mark frames; MuJoCo's viewer hides 3 and above
FREE_JOINT = "floating_base"


@dataclass(frozen=True)
class Options:
    """What a URDF leaves to whoever converts it."""

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
    """A robot's spec, and what is to be said about how it came about."""

    spec: mujoco.MjSpec
    report: Report


def open_meshes(urdf: Urdf, options: Options, report: Report) -> Meshes:
    """The URDF's mesh files, where `options` let them be; `report` hears what is left out."""
    folders = [folder for folder in (urdf.folder, *options.mesh_folders) if folder]
    if urdf.mesh_folder:
        # As MuJoCo has it, from the URDF's folder; a run's copy of the URDF has that as another.
        named = [folder / urdf.mesh_folder for folder in folders]
        folders = [*(f for f in named if is_inside(f, folders)), *folders]
    return Meshes(folders if options.meshes else None, urdf.source, report)


def convert(urdf: Urdf, legs: tuple[Leg, ...] = (), options: Options | None = None) -> Conversion:
    """The robot above a floor, with its `home` keyframe; `UrdfError` where that cannot be.

    `legs` of a quadruped are in the order that the model's joints and actuators shall have. Without
    them, joints keep the file's order and home is joint position 0.
    """
    options = options or Options()
    report = deepcopy(urdf.report)
    spec = mujoco.MjSpec()
    spec.modelname = urdf.robot.name
    origin = Path(urdf.source).name.replace("--", "-")
    spec.comment = f"Converted from {origin} by quadwalk.robot: change that, and convert again."
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    # All mass is the links' <inertial>: a link without one gets none invented from its shapes.
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.timestep = 0.002
    spec.nuser_jnt = 1
    add_scene(spec)
    add_geom_classes(spec)
    robot = _Robot(spec, urdf, legs, options, report)
    try:
        robot.add_bodies()
        robot.add_motors()
        robot.add_sensors()
        pose = standing_pose(urdf.tree, legs, urdf.source) if legs else None
        add_home(spec, pose, [leg.foot_name for leg in legs])
        overlaps = exclude_overlaps(spec)
    except (ValueError, mujoco.FatalError) as error:  # of MuJoCo's compiler: a flat mesh, say
        reason = " ".join(str(error).split())
        raise UrdfError(f"{urdf.source}: MuJoCo does not take this robot: {reason}") from None
    for pair in overlaps:
        report.add("assumed", "never touch, for they overlap in the home pose", pair)
    return Conversion(spec, report)


def write_xml(spec: mujoco.MjSpec) -> str:
    """The MJCF of `spec`, the same each time; of 6 digits, hence a relative error of some 1e-6."""
    spec = spec.copy()
    for body in spec.bodies:
        if body.mass > 0:
            body.inertia = printable(body.inertia)
    spec.compile()
    return spec.to_xml()


@dataclass
class _Robot:
    """The robot under construction in a spec."""

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
        root = self.tree.root
        whole = body_inertia(self.tree, root)
        if root == "world" and self.options.floating is not True:
            return False
        floating = self.options.floating
        if floating is None:
            floating = bool(self.legs) or whole is not None
            if not floating:
                self.report.add("assumed", "fixed to the ground, for it has no mass", root)
        if not floating:
            return False
        if root == "world" or whole is None or whole.mass < SMALLEST:
            raise UrdfError(
                f"{self.urdf.source}: link '{root}' is to float and has no mass; expected "
                "<inertial> with a mass above 0, or a fixed base"
            )
        if principal(whole.about_com)[0][2] < SMALLEST:
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
            below = sorted(self.tree.moving_joints(name), key=lambda j: rank.get(j.child, -1))
            # Past links without mass, whose joints their bodies have as well.
            ends = [self.tree.chain_from(joint)[-1].child for joint in below]
            pending.extend((end, body) for end in reversed(ends))
        moving = {joint.name for joint in self.joints}
        for joint in self.joints:
            mimic = joint.mimic
            if mimic is None:
                continue
            follow = self.spec.add_equality(
                name=joint.name,
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=joint.name,
                # One that is fixed stays at 0.
                name2=mimic.joint if mimic.joint in moving else "",
            )
            factor = 1.0 if mimic.multiplier is None else mimic.multiplier
            follow.data[:2] = [mimic.offset or 0.0, factor]
        for name in self.tree.bodies[1:]:
            if self.tree.passes_on(name):
                continue
            # No contact between bodies that share a joint: their shapes meet at it by design.
            above = self.tree.body_of[self.tree.joints_to(name)[0].parent]
            self.spec.add_exclude(name=f"{above}-{name}", bodyname1=above, bodyname2=name)

    def _add_body(self, parent: mujoco.MjsBody, name: str) -> mujoco.MjsBody:
        """Add the body of moving link (or root) `name`, with all that is fused with it."""
        tree = self.tree
        body = parent if name == "world" else parent.add_body(name=name)
        joints = tree.joints_to(name)
        if joints:
            frames = [tree.frame_of(joint) for joint in joints]
            body.pos, body.quat = pose(reduce(np.matmul, frames))
            for i, joint in enumerate(joints):
                # From the joint on to the body, all later joints at 0.
                onwards = reduce(np.matmul, frames[i + 1 :], np.eye(4))
                self._add_joint(body, joint, np.linalg.inv(onwards))
                if joint.child != name:
                    self._pass_on(joint, name)
        elif self.floating:
            body.add_freejoint(name=unique(FREE_JOINT, self.joint_names))
            add_sun(body)
        else:
            add_sun(self.spec.worldbody)
        whole = body_inertia(tree, name)
        if whole is not None and (joints or self.floating):
            body.explicitinertial = True
            body.mass, body.ipos = whole.mass, whole.com
            body.inertia, body.iquat = principal(whole.about_com)
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
        pos, quat = pose(frame)
        body.add_site(name=name, pos=pos, quat=quat, group=FRAMES, size=[radius] * 3)

    def _pass_on(self, joint: yourdfpy.Joint, name: str) -> None:
        """Note that a joint moves body `name` over a link without mass, which is no body."""
        self.report.add("fused", "joints over links without mass", f"{joint.name} with {name}")
        for part in self.tree.parts[joint.child]:
            if self.tree.links[part].visuals:
                self.report.add("dropped", "visual shapes of links without mass", part)

    def _add_joint(self, body: mujoco.MjsBody, joint: yourdfpy.Joint, frame: np.ndarray) -> None:
        if joint.type in SINGLE:
            armature = {**self.urdf.armature, **self.options.armature}
            add_single(body, joint, armature.get(joint.name, 0.0), frame)
            self.joints.append(joint)
            return
        add_several(body, joint, self.joint_names)
        self.report.add("assumed", f"no motor, for it is {joint.type}", joint.name)
        if joint.dynamics is not None or joint.limit is not None:
            self.report.add("dropped", "limits and dynamics of several directions", joint.name)

    def add_motors(self) -> None:
        """One motor per joint, named after it, of gear 1 and within the effort limit."""
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
        """For a floating robot an IMU: gyro, accelerometer, orientation; touch sensors in feet."""
        kinds = mujoco.mjtSensor
        if self.floating:
            root = self.tree.root
            site = next((name for name in self.tree.parts[root][1:] if "imu" in name.lower()), None)
            if site is None:
                site = unique("imu", set(self.tree.links))
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
