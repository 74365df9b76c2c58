"""Reading of MJCF: MuJoCo compiles the file, and its quadruped is written as a URDF.

So there is one way from there on, for either format. Defaults, includes, frames, angles and
inertias of shapes are MuJoCo's work; numbers keep all their digits. Floor, lights, cameras,
sensors, solver settings and other bodies are not the robot's, and are left out.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree
from trimesh.transformations import rotation_matrix, translation_matrix

from quadwalk.robot.checks.elements import write_numbers
from quadwalk.robot.names import find_robot
from quadwalk.robot.report import UrdfError
from quadwalk.robot.scene import compute_rotation
from quadwalk.robot.structure.home import STANDING_LENGTH
from quadwalk.robot.structure.tree import make_unique, to_roll_pitch_yaw
from quadwalk.robot.urdf import Urdf, parse_urdf, read_file

# MJCF has no largest speed of a joint. Unitree's URDFs give knees so many times sqrt(g / h), with h
# the standing height: AlienGo 3.0, A1 and Go1 3.5.
SPEED = 3.0
GRAVITY = 9.81  # m/s^2
KEYFRAMES = ("home", "stand", "standing")  # the first of these is the home pose
# In the comment of what `quadwalk robot` writes, whose joints have their speed as a user datum.
OURS = "quadwalk.robot"
# Numbers below this are what rounding leaves of a 0.
NOTHING = 1e-30
_NO_ELEMENT = re.compile(rb"<!--.*?-->|<\?.*?\?>", re.DOTALL)  # comments and instructions
_ELEMENT = re.compile(rb"<([A-Za-z_][\w.-]*)")
_FREE, _BALL = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL
_HINGE = mujoco.mjtJoint.mjJNT_HINGE
_Geom = mujoco.mjtGeom
_GRAY = (0.5, 0.5, 0.5, 1.0)  # of a geom that states no color


def read_robot(
    file: str | Path,
    repair_inertia: bool = False,
    fix: tuple[str, ...] = (),
    speed: float | None = None,
) -> Urdf:
    """Read and check a robot's URDF or MJCF, or one of a package by its name, as `read_urdf`."""
    path = find_robot(Path(file))
    data = read_file(path)
    if is_mjcf(data):
        return read_mjcf(path, repair_inertia, fix, speed)
    return parse_urdf(data, str(path), path.resolve().parent, repair_inertia, fix)


def is_mjcf(data: bytes) -> bool:
    """Return True if the root element of an XML document is MJCF's."""
    root = _ELEMENT.search(_NO_ELEMENT.sub(b"", data))
    return root is not None and root[1] in (b"mujoco", b"mujocoinclude")


def read_mjcf(
    path: Path,
    repair_inertia: bool = False,
    fix: tuple[str, ...] = (),
    speed: float | None = None,
) -> Urdf:
    """Read the quadruped in the MJCF file at `path`, as `read_urdf` reads a URDF.

    Without a `speed` limit of its motors, rad/s, one is assumed and written into the URDF's text.
    Raise `UrdfError` where MuJoCo does not compile the file, or something drives or couples the
    robot's joints that a URDF has no words for.
    """
    source = str(path)
    try:
        spec = mujoco.MjSpec.from_file(source)
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise UrdfError(f"{source}: MuJoCo does not read this MJCF: {reason}") from None
    writer = _Writer(source, spec, model, speed)
    text = writer.write()
    urdf = parse_urdf(text, source, path.resolve().parent, repair_inertia, fix)
    for kind, note, element in writer.notes:
        urdf.report.add(kind, note, element)
    writer.check_moving(urdf)
    return urdf


@dataclass
class _Writer:
    """The robot of a compiled MJCF, and the URDF that is made of it."""

    source: str
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    speed: float | None  # rad/s, of all motors; None: one is assumed
    notes: list[tuple[str, str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.trunk = self._find_trunk()
        self.bodies = [self.trunk]
        for body in range(self.trunk + 1, self.model.nbody):
            if self.model.body_parentid[body] in self.bodies:
                self.bodies.append(body)
        self.link_names = self._name_links()
        self.joint_names: dict[int, str] = {}
        for body in self.bodies[1:]:
            for joint in self._list_joints(body):
                name = self.model.joint(joint).name or f"{self.link_names[body]}_joint"
                self.joint_names[joint] = make_unique(name, self.joint_names.values())
        self.is_ours = OURS in self.spec.comment and self.model.nuser_jnt > 0
        self.efforts = self._compute_efforts()
        self.home = self._find_home()

    def write(self) -> str:
        """Return the URDF's text."""
        robot = etree.Element("robot", name=self.spec.modelname or Path(self.source).stem)
        speed = self._choose_speed() if self.speed is None else None
        for body in self.bodies:
            if body != self.trunk:
                self._add_joints(robot, body, speed)
            self._add_link(robot, body)
        self._note_what_is_dropped()
        return etree.tostring(robot, encoding="unicode", pretty_print=True)

    def _refuse(self, message: str) -> UrdfError:
        return UrdfError(f"{self.source}: {message}")

    def _list_joints(self, body: int) -> range:
        first, count = self.model.body_jntadr[body], self.model.body_jntnum[body]
        return range(first, first + count)

    def _find_trunk(self) -> int:
        """Return the body in the world that joints of legs lead from."""
        model = self.model
        roots = model.body_rootid[model.jnt_bodyid]
        below = roots[(model.jnt_type == _HINGE) & (roots != model.jnt_bodyid)]
        counts = np.bincount(below, minlength=model.nbody)
        # Other things with hinges, such as a door, have fewer than a quadruped.
        trunks = np.flatnonzero(counts >= min(12, max(int(counts.max()), 1)))
        if len(trunks) != 1:
            names = ", ".join(f"'{model.body(int(body)).name}'" for body in trunks)
            what = f"has {len(trunks)} robots, {names}" if names else "has no body with joints"
            raise self._refuse(f"{what}; expected one quadruped: four legs of three hinge joints")
        trunk = int(trunks[0])
        for joint in self._list_joints(trunk):
            if model.jnt_type[joint] != _FREE:
                raise self._refuse(
                    f"joint '{model.joint(joint).name}' moves the trunk "
                    f"'{model.body(trunk).name}' against the world; expected a free joint or none"
                )
        return trunk

    def _name_links(self) -> dict[int, str]:
        names: dict[int, str] = {}
        for body in self.bodies:
            name = self.model.body(body).name or f"body_{body}"
            names[body] = make_unique(name, {"world", *names.values()})
        return names

    def _compute_efforts(self) -> dict[int, float]:
        """Return the torque or force, N m or N, that actuators can give each joint they drive."""
        model = self.model
        efforts: dict[int, float] = {}
        joint_kinds = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        for row in range(model.nu):
            name = model.actuator(row).name
            if int(model.actuator_trntype[row]) not in joint_kinds:
                self.notes.append(("dropped", "actuators that drive no joint", name))
                continue
            joint = int(model.actuator_trnid[row, 0])
            if joint not in self.joint_names:
                continue
            efforts[joint] = efforts.get(joint, 0.0) + self._compute_effort(row)
            if model.actuator_biastype[row] != mujoco.mjtBias.mjBIAS_NONE:
                self.notes.append(("dropped", "gains of actuators, for training has its own", name))
        for joint in self.joint_names:
            if model.jnt_actfrclimited[joint] and joint in efforts:
                limit = float(np.abs(model.jnt_actfrcrange[joint]).min())
                efforts[joint] = min(efforts[joint], limit)
        return efforts

    def _compute_effort(self, row: int) -> float:
        """Return the largest torque or force of an actuator either way, N m or N; inf for none."""
        model = self.model
        force = np.inf
        if model.actuator_forcelimited[row]:
            force = np.abs(model.actuator_forcerange[row]).min()
        is_direct = (
            model.actuator_gaintype[row] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[row] == mujoco.mjtBias.mjBIAS_NONE
            and model.actuator_dyntype[row] != mujoco.mjtDyn.mjDYN_INTEGRATOR
        )
        if is_direct and model.actuator_ctrllimited[row]:
            ctrl = np.abs(model.actuator_ctrlrange[row]).min()
            force = min(force, abs(model.actuator_gainprm[row, 0]) * ctrl)
        return float(force * abs(model.actuator_gear[row, 0]))

    def _sum_rotors(self, joint: int) -> tuple[float, float]:
        """Return the armature, kg m^2, and damping, N m s/rad, of a joint with its actuators'."""
        model = self.model
        dof = model.jnt_dofadr[joint]
        armature, damping = model.dof_armature[dof], model.dof_damping[dof]
        for row in np.flatnonzero(model.actuator_trnid[:, 0] == joint):
            if model.actuator_trntype[row] == mujoco.mjtTrn.mjTRN_JOINT:
                gear = model.actuator_gear[row, 0]
                armature += gear**2 * model.actuator_armature[row]
                damping += gear**2 * model.actuator_damping[row]
        return float(armature), float(damping)

    def _find_home(self) -> np.ndarray | None:
        """Return qpos of the keyframe that is the home pose; None without one."""
        keys = {self.model.key(row).name.lower(): row for row in reversed(range(self.model.nkey))}
        return next((self.model.key_qpos[keys[name]] for name in KEYFRAMES if name in keys), None)

    def _choose_speed(self) -> float | None:
        """Return the speed limit, rad/s, that suits the legs' length; None where there are none."""
        calves = [body for body in self.bodies if self._count_joints_above(body) == 3]
        thighs = [float(np.linalg.norm(self.model.body_pos[body])) for body in calves]
        if self.is_ours or max(thighs, default=0.0) == 0:
            return None
        height = STANDING_LENGTH * 2 * max(thighs)
        speed = float(f"{SPEED * np.sqrt(GRAVITY / height):.3g}")
        note = f"a speed limit of {speed:g} rad/s, for MJCF has none (or pass --robot.speed)"
        self.notes.append(("assumed", note, ""))
        return speed

    def _count_joints_above(self, body: int) -> int:
        count = 0
        while body != self.trunk:
            count += self.model.body_jntnum[body]
            body = self.model.body_parentid[body]
        return count

    def _get_anchor(self, body: int) -> np.ndarray:
        """Return where the link's origin lies in the body's frame (3,), m: in its last joint."""
        joints = self._list_joints(body) if body != self.trunk else ()
        return self.model.jnt_pos[joints[-1]] if joints else np.zeros(3)

    def _add_joints(self, robot: etree._Element, body: int, speed: float | None) -> None:
        """Add the joints that move a body, one after another, or the one that fixes it."""
        model = self.model
        parent = int(model.body_parentid[body])
        above = self.link_names[parent]
        frame = translation_matrix(-self._get_anchor(parent)) @ _to_frame(
            model.body_pos[body], model.body_quat[body]
        )
        joints = self._list_joints(body)
        if not joints:
            name = make_unique(f"{self.link_names[body]}_fixed", self.joint_names.values())
            self._add_joint(robot, name, "fixed", above, self.link_names[body], frame)
            return
        at = np.zeros(3)
        for joint in joints:
            frame = frame @ translation_matrix(model.jnt_pos[joint] - at)
            at = model.jnt_pos[joint]
            link = self.link_names[body]
            if joint != joints[-1]:
                link_names = {*self.link_names.values()}
                link = make_unique(f"{self.joint_names[joint]}_link", link_names)
                etree.SubElement(robot, "link", name=link)
            self._add_moving(robot, joint, above, link, frame, speed)
            above, frame = link, np.eye(4)

    def _add_moving(self, robot, joint, above, link, frame, speed) -> None:
        """Add a joint that moves, with what its motor can do; `frame` (4, 4) is that at `ref`."""
        model = self.model
        name, axis = self.joint_names[joint], model.jnt_axis[joint]
        turns, address = model.jnt_type[joint] == _HINGE, model.jnt_qposadr[joint]
        if int(model.jnt_type[joint]) in (_FREE, _BALL):
            raise self._refuse(f"joint '{name}' is a ball joint; expected hinge joints")
        # URDF's joints are 0 in the frame that is written; MuJoCo's are at `ref`.
        back = -model.qpos0[address]
        shift = rotation_matrix(back, axis) if turns else translation_matrix(back * axis)
        limited = bool(model.jnt_limited[joint])
        kind = ("revolute" if limited else "continuous") if turns else "prismatic"
        element = self._add_joint(robot, name, kind, above, link, frame @ shift)
        etree.SubElement(element, "axis", xyz=_write(axis))
        limit = etree.SubElement(element, "limit")
        if limited:
            lower, upper = model.jnt_range[joint]
            limit.set("lower", _write(lower))
            limit.set("upper", _write(upper))
        effort = self.efforts.get(joint, np.inf)
        if np.isfinite(effort):
            limit.set("effort", _write(effort))
        if self.is_ours and self.speed is None and model.jnt_user[joint, 0] > 0:
            speed = model.jnt_user[joint, 0]
        if speed is not None:
            limit.set("velocity", _write(speed))
        armature, damping = self._sum_rotors(joint)
        friction = model.dof_frictionloss[model.jnt_dofadr[joint]]
        dynamics = etree.SubElement(
            element, "dynamics", damping=_write(damping), friction=_write(friction)
        )
        if armature > 0:
            dynamics.set("armature", _write(armature))
        if self.home is not None:
            dynamics.set("home", _write(self.home[address]))

    def _add_joint(self, robot, name, kind, above, link, frame) -> etree._Element:
        element = etree.SubElement(robot, "joint", name=name, type=kind)
        _add_origin(element, frame)
        etree.SubElement(element, "parent", link=above)
        etree.SubElement(element, "child", link=link)
        return element

    def _add_link(self, robot: etree._Element, body: int) -> None:
        """Add a body's link: inertia, shapes, and frames of its IMU."""
        model = self.model
        link = etree.SubElement(robot, "link", name=self.link_names[body])
        to_link = translation_matrix(-self._get_anchor(body))
        if model.body_mass[body] > 0:
            frame = to_link @ _to_frame(model.body_ipos[body], model.body_iquat[body])
            axes = frame[:3, :3]
            tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
            inertial = etree.SubElement(link, "inertial")
            etree.SubElement(inertial, "origin", xyz=_write(frame[:3, 3]))
            etree.SubElement(inertial, "mass", value=_write(model.body_mass[body]))
            entries = {
                f"i{'xyz'[i]}{'xyz'[j]}": _write(tensor[i, j])
                for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
            }
            etree.SubElement(inertial, "inertia", entries)
        for geom in np.flatnonzero(model.geom_bodyid == body):
            self._add_shape(link, int(geom), to_link)
        for site in np.flatnonzero(model.site_bodyid == body):
            name = model.site(int(site)).name
            if body == self.trunk and "imu" in name.lower():
                name = make_unique(name, self.link_names.values())
                pose = _to_frame(model.site_pos[site], model.site_quat[site])
                etree.SubElement(robot, "link", name=name)
                joint = make_unique(f"{name}_fixed", self.joint_names.values())
                self._add_joint(robot, joint, "fixed", link.get("name"), name, to_link @ pose)

    def _add_shape(self, link: etree._Element, geom: int, to_link: np.ndarray) -> None:
        """Add a geom as a shape that is seen, or that collides."""
        model = self.model
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        collides = collides or geom in model.pair_geom1 or geom in model.pair_geom2
        frame = to_link @ _to_frame(model.geom_pos[geom], model.geom_quat[geom])
        kind, size = model.geom_type[geom], model.geom_size[geom]
        mesh = int(model.geom_dataid[geom])
        if kind == _Geom.mjGEOM_MESH and mesh >= 0:
            # MuJoCo moves a mesh into its principal axes, and the geom against that.
            frame = frame @ np.linalg.inv(_to_frame(model.mesh_pos[mesh], model.mesh_quat[mesh]))
            file = self._find_mesh_file(mesh)
            scale = _write(model.mesh_scale[mesh])
            shape = {"tag": "mesh", "filename": file, "scale": scale} if file else None
        else:
            shape = _describe_shape(kind, size)
        name = link.get("name")
        if shape is None:
            what = "collision" if collides else "visual"
            label = _Geom(int(kind)).name.removeprefix("mjGEOM_").lower()
            note = f"{what} shapes of a kind that URDF has not"
            self.notes.append(("dropped", note, f"{name} {label}"))
            return
        element = etree.SubElement(link, "collision" if collides else "visual")
        _add_origin(element, frame)
        geometry = etree.SubElement(element, "geometry")
        tag = shape.pop("tag")
        etree.SubElement(geometry, tag, shape)
        if not collides:
            rgba = self._get_color(geom)
            material = etree.SubElement(element, "material", name="rgba " + _write(rgba))
            etree.SubElement(material, "color", rgba=_write(rgba))

    def _find_mesh_file(self, mesh: int) -> str:
        """Return the mesh's file from the MJCF's folder; "" where a URDF can name none."""
        asset = self.spec.meshes[mesh]
        is_turned = np.any(asset.refpos != 0) or np.any(asset.refquat != [1, 0, 0, 0])
        if not asset.file or is_turned:
            return ""
        return (Path(self.spec.compiler.meshdir or "") / asset.file).as_posix()

    def _get_color(self, geom: int) -> np.ndarray:
        material = self.model.geom_matid[geom]
        rgba = self.model.geom_rgba[geom]
        if material >= 0 and np.allclose(rgba, _GRAY):
            rgba = self.model.mat_rgba[material]
        return np.round(rgba.astype(np.float64), 6)

    def _note_what_is_dropped(self) -> None:
        """Note what of the file is left out that moves a robot, or that a user might look for."""
        model, option = self.model, self.model.opt
        others = [body for body in range(1, model.nbody) if body not in self.bodies]
        for body in others:
            self.notes.append(("dropped", "other bodies", model.body(body).name or f"body {body}"))
        if np.any(model.body_gravcomp[self.bodies]):
            self.notes.append(("dropped", "compensation of gravity", ""))
        if np.any(option.gravity != [0, 0, -GRAVITY]) or option.density or option.viscosity:
            self.notes.append(("dropped", "gravity other than 9.81 m/s^2, air or water", ""))
        for joint in self._list_joints(self.trunk):
            dof = model.jnt_dofadr[joint]
            if model.dof_armature[dof] or model.dof_damping[dof] or model.dof_frictionloss[dof]:
                what = "armature, damping and friction of the trunk's free joint"
                self.notes.append(("dropped", what, ""))

    def check_moving(self, urdf: Urdf) -> None:
        """Refuse what acts on the joints that move in `urdf` besides their motors."""
        model = self.model
        moving = {joint.name for joint in urdf.robot.joints if joint.type != "fixed"}
        joints = {row for row, name in self.joint_names.items() if name in moving}
        body_of, root = urdf.tree.body_of, urdf.tree.root
        bodies = {body for body in self.bodies if body_of[self.link_names[body]] != root}
        for joint in sorted(joints):
            dof = model.jnt_dofadr[joint]
            spring = model.jnt_stiffness[joint] or np.any(model.jnt_stiffnesspoly[joint])
            if spring or np.any(model.dof_dampingpoly[dof]):
                raise self._refuse(
                    f"joint '{self.joint_names[joint]}' has a spring or damping that is not "
                    "linear; expected neither"
                )
        for row in range(model.neq):
            self._check_equality(row, joints, bodies)
        for row in range(model.ntendon):
            first = model.tendon_adr[row]
            wraps = range(first, first + model.tendon_num[row])
            if any(self._is_wrapped(wrap, joints, bodies) for wrap in wraps):
                raise self._refuse(
                    f"tendon '{model.tendon(row).name}' runs over the robot's joints; expected "
                    "legs without tendons"
                )

    def _check_equality(self, row: int, joints: set[int], bodies: set[int]) -> None:
        """Refuse an equality constraint of the robot's joints or links."""
        model = self.model
        kind, name = model.eq_type[row], model.eq(row).name or f"number {row}"
        ends = [int(model.eq_obj1id[row]), int(model.eq_obj2id[row])]
        if int(kind) in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            if model.eq_objtype[row] == mujoco.mjtObj.mjOBJ_SITE:
                ends = [int(model.site_bodyid[end]) for end in ends]
            couples = not bodies.isdisjoint(ends)
        else:
            couples = kind == mujoco.mjtEq.mjEQ_JOINT and not joints.isdisjoint(ends)
        if couples:
            raise self._refuse(
                f"equality constraint '{name}' couples the robot's joints; expected legs of three "
                "hinge joints that move freely"
            )

    def _is_wrapped(self, wrap: int, joints: set[int], bodies: set[int]) -> bool:
        """Return True if part `wrap` of a tendon is on a joint or link that moves."""
        kind, row = self.model.wrap_type[wrap], int(self.model.wrap_objid[wrap])
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            return row in joints
        if kind == mujoco.mjtWrap.mjWRAP_SITE:
            return int(self.model.site_bodyid[row]) in bodies
        return False


def _describe_shape(kind: int, size: np.ndarray) -> dict[str, str] | None:
    """Return tag and attributes of a shape; None for one that URDF has not."""
    if kind == _Geom.mjGEOM_BOX:
        return {"tag": "box", "size": _write(2 * size)}
    if kind == _Geom.mjGEOM_SPHERE:
        return {"tag": "sphere", "radius": _write(size[0])}
    tag = {_Geom.mjGEOM_CAPSULE: "capsule", _Geom.mjGEOM_CYLINDER: "cylinder"}.get(int(kind))
    if not tag:
        return None
    return {"tag": tag, "radius": _write(size[0]), "length": _write(2 * size[1])}


def _to_frame(pos: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Return the frame (4, 4) of a position (3,), m, and a quaternion wxyz (4,)."""
    frame = translation_matrix(pos)
    frame[:3, :3] = compute_rotation(quat)
    return frame


def _add_origin(element: etree._Element, frame: np.ndarray) -> None:
    rpy = to_roll_pitch_yaw(frame[:3, :3])
    etree.SubElement(element, "origin", xyz=_write(frame[:3, 3]), rpy=_write(rpy))


def _write(numbers: np.ndarray | float) -> str:
    """Return numbers with all their digits, but 0 for what is nothing."""
    numbers = np.atleast_1d(np.asarray(numbers, np.float64))
    return write_numbers(np.where(np.abs(numbers) < NOTHING, 0.0, numbers))
