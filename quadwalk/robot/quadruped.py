"""A quadruped as the environments see it: names, limits, standing pose, and its two models."""

from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
import yourdfpy

from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.checks.units import check_limits, check_size
from quadwalk.robot.from_mjcf import read_robot
from quadwalk.robot.mjcf import Options, convert, open_meshes
from quadwalk.robot.report import Report, UrdfError
from quadwalk.robot.scene import HOME, Contacts, add_spheres, make_training_shapes
from quadwalk.robot.structure.facing import find_turn
from quadwalk.robot.structure.home import compute_standing_pose
from quadwalk.robot.structure.legs import Leg, find_chains, find_legs
from quadwalk.robot.structure.tree import get_range, name_axis
from quadwalk.robot.urdf import Urdf, release_from_world, turn_root

# A motor's rotor, through its gear, by the robot's mass times its standing height squared: the
# AlienGo's are 0.005 on average, and 0.008 is what MuJoCo Menagerie gives the Go1 and the A1.
ROTOR = 0.006


@dataclass(frozen=True, eq=False)
class Quadruped:
    """A quadruped read from a URDF.

    Joints are ordered leg by leg (FR, FL, RR, RL), hip, thigh, calf, whatever the file's order:
    `joints[i]` is qpos[7 + i], qvel[6 + i] and actuator i of both models.
    """

    name: str  # the URDF's robot name
    urdf: str  # the URDF's text, as read, and as turned where its root link has not x ahead
    legs: tuple[str, ...]  # ("FR", "FL", "RR", "RL")
    joints: tuple[str, ...]  # (12) names; each joint's actuator has the same name
    feet: tuple[str, ...]  # (4) names of both the foot's frame (a site) and its sphere (a geom)
    trunk: str  # name of the floating body, the URDF's root link
    lower: np.ndarray  # (12,) rad, position limits; -pi for a continuous joint
    upper: np.ndarray  # (12,) rad, the same; pi
    effort: np.ndarray  # (12,) N m, largest torque
    velocity: np.ndarray  # (12,) rad/s, largest speed
    # (12,) N m, Coulomb friction of the joints. The models have none: it belongs to the motor
    # model, so that all engines apply the same.
    friction: np.ndarray
    # (19,) qpos standing: x y z (m), quaternion wxyz, joints (rad), feet just at height 0
    home: np.ndarray
    notes: tuple[str, ...]  # what was repaired, dropped or assumed in conversion, lines of text
    spec: mujoco.MjSpec = field(repr=False)

    @property
    def gravity(self) -> float:
        """m/s^2, downwards, in both models."""
        return float(-self.spec.option.gravity[2])

    @property
    def foot_speed(self) -> float:
        """m/s, at most, of a foot that swings about the thigh's joint under the trunk."""
        return float(self.home[2] * self.velocity[1::3].min())

    def make_training_model(
        self,
        timestep: float,
        iterations: int = 1,
        ls_iterations: int = 5,
        contacts: Contacts = "feet",
    ) -> mujoco.MjModel:
        """Make the model to train in, which MJX takes: only spheres and the floor collide.

        Body, joint, actuator and collision geom names are those of `make_full_model`; the other
        collision shapes are there to be measured, but touch nothing. No visuals, no sensors.

        `timestep` is in s; with one of the Newton solver's `iterations`, MJX needs no loop that
        runs as long as the slowest robot of a batch. `contacts`: the floor meets feet, or also
        spheres at knees, or those and the trunk's lower corners, or also its upper ones and hips.
        """
        spec = self.spec.copy()
        for sensor in list(spec.sensors):
            spec.delete(sensor)
        for element in [*spec.excludes, *spec.lights]:
            spec.delete(element)
        _delete_visuals(spec)
        for geom in spec.geoms:
            # Only floor against foot passes MuJoCo's test, contype of one & conaffinity of the
            # other; feet do not meet each other.
            geom.contype = geom.name == "floor"
            geom.conaffinity = geom.name in self.feet
        make_training_shapes(spec, self.feet)
        if contacts != "feet":
            add_spheres(spec, self.trunk, self.feet, self.joints[2::3], contacts)
        spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
        return self._compile(spec, timestep, iterations, ls_iterations, frictionloss=False)

    def make_full_model(
        self, timestep: float = 0.002, frictionloss: bool = False, visuals: bool = True
    ) -> mujoco.MjModel:
        """Make the model to evaluate in: every collision shape, a solver that converges.

        `timestep` is in s. With `frictionloss` the joints have the URDF's friction, for a user
        without the motor model that otherwise applies it. Without `visuals`, which are nearly all
        of its memory, it has collision shapes only.
        """
        spec = self.spec.copy()
        if not visuals:
            _delete_visuals(spec)
        return self._compile(spec, timestep, 100, 50, frictionloss)

    def _compile(self, spec, timestep, iterations, ls_iterations, frictionloss) -> mujoco.MjModel:
        spec.option.timestep = timestep
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        spec.option.iterations = iterations
        spec.option.ls_iterations = ls_iterations
        spec.option.tolerance = 1e-8
        if not frictionloss:
            for joint in spec.joints:
                joint.frictionloss = 0
        return spec.compile()


def _delete_visuals(spec: mujoco.MjSpec) -> None:
    """Delete visual geoms and their meshes, and the materials and textures of the others."""
    for geom in list(spec.geoms):
        geom.material = ""
        if geom.classname.name == "visual":
            spec.delete(geom)
    collision_meshes = {geom.meshname for geom in spec.geoms}
    visual_meshes = [mesh for mesh in spec.meshes if mesh.name not in collision_meshes]
    for element in [*spec.materials, *spec.textures, *visual_meshes]:
        spec.delete(element)


def load_quadruped(
    file: str | Path = ALIENGO_URDF,
    options: Options | None = None,
    repair_inertia: bool = False,
    fix: tuple[str, ...] = (),
) -> Quadruped:
    """Read a quadruped's URDF or MJCF; `UrdfError` where it is not valid or not a quadruped."""
    options = options or Options()
    return make_quadruped(read_robot(file, repair_inertia, fix, options.speed), options)


def find_quadruped(urdf: Urdf, options: Options) -> tuple[Urdf, tuple[Leg, ...]]:
    """Return the robot, turned so that x is ahead and z up, and its legs; it can stand.

    Raise `UrdfError` where it is no quadruped, of no quadruped's size, or of unclear direction.
    """
    check_limits(urdf.tree, find_chains(urdf.tree))
    # The conversion notes which meshes are left out.
    meshes = open_meshes(urdf, options, Report())
    turn, reasons = find_turn(urdf.tree, meshes)
    if reasons:
        urdf = turn_root(urdf, turn, reasons)
    legs = find_legs(urdf.tree, meshes)
    report = deepcopy(urdf.report)
    check_size(urdf.tree, legs, report)
    compute_standing_pose(urdf.tree, legs)
    return replace(urdf, report=report), legs


def complete_motors(urdf: Urdf, legs: tuple[Leg, ...], options: Options) -> Urdf:
    """Fill in the effort and speed of `options` where legs' motors have no limits.

    Raise `UrdfError` where some still have none, or a leg's joint follows another.
    """
    joint_above = urdf.tree.joint_above
    completed: dict[str, yourdfpy.Joint] = {}
    lacking: dict[str, list[str]] = {"effort": [], "speed": []}
    for joint in (joint_above[link] for leg in legs for link in leg.links):
        if joint.mimic is not None:
            raise UrdfError(
                f"{urdf.source}: joint '{joint.name}' of a leg follows another; expected a motor"
            )
        limit = joint.limit or yourdfpy.Limit()
        values = {"effort": limit.effort, "speed": limit.velocity}
        for name, value in values.items():
            if not value or value == np.inf:
                values[name] = getattr(options, name)
                if values[name] is None:
                    lacking[name].append(joint.name)
        limit = replace(limit, effort=values["effort"], velocity=values["speed"])
        completed[joint.name] = replace(joint, limit=limit)
    lacking = {name: joints for name, joints in lacking.items() if joints}
    if lacking:
        flags = {"effort": "--robot.effort NM", "speed": "--robot.speed RAD_PER_S"}
        missing = ", ".join(f"no {name} limit for {_shorten(lacking[name])}" for name in lacking)
        raise UrdfError(
            f"{urdf.source}: has {missing}; expected <limit effort=... velocity=...> above 0 (in "
            "MJCF an actuator with a range of forces), or pass "
            f"{' '.join(flags[name] for name in lacking)}"
        )
    joints = [completed.get(joint.name, joint) for joint in urdf.robot.joints]
    return replace(urdf, robot=replace(urdf.robot, joints=joints))


def _shorten(names: list[str]) -> str:
    """Return the first two names and the number of others, as in "'a' and 'b' and 3 more"."""
    text = " and ".join(f"'{name}'" for name in names[:2])
    return text + (f" and {len(names) - 2} more" if names[2:] else "")


def list_joints(spec: mujoco.MjSpec, legs: tuple[Leg, ...]) -> list[str]:
    """Return a table of each leg's joints, with the axis of the trunk that each turns about.

    Axes are those of the home pose; a joint of sign + turns about it as a right hand does.
    """
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    rows = [
        [leg.name, *(f"{name_axis(data.joint(name).xaxis)} {name}" for name in leg.joints)]
        for leg in legs
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in [["leg", "hip", "thigh", "calf"], *rows]
    ]


def add_rotors(
    spec: mujoco.MjSpec, joints: list[yourdfpy.Joint], stated: set[str], report: Report
) -> None:
    """Give `joints` rotors as a robot's motors have, but for those whose armature is `stated`.

    URDF cannot state them, so most files have none, and legs without them are lighter than any
    motor could turn: it whips them about.
    """
    mass, height = sum(body.mass for body in spec.bodies), spec.key(HOME).qpos[2]
    rotor = float(f"{ROTOR * mass * height**2:.2g}")
    for joint in joints:
        if joint.name not in stated:
            spec.joint(joint.name).armature = rotor
            report.add("assumed", f"rotors of {rotor:g} kg m^2 (armature)", joint.name)


def make_quadruped(urdf: Urdf, options: Options | None = None) -> Quadruped:
    """Make the quadruped that a checked URDF describes; `UrdfError` says why it is none."""
    options = options or Options()
    original = urdf = release_from_world(urdf)
    urdf, legs = find_quadruped(urdf, options)
    urdf = complete_motors(urdf, legs, options)
    tree = urdf.tree
    joints = [tree.joint_above[link] for leg in legs for link in leg.links]
    conversion = convert(urdf, legs, replace(options, floating=True))
    spec, report = conversion.spec, conversion.report
    add_rotors(spec, joints, {*urdf.armature, *options.armature}, report)
    notes = [note for note in report.to_lines() if not note.startswith("fused")]
    if tree.root != original.tree.root:
        notes += list_joints(spec, legs)
    ranges = np.array([get_range(joint) for joint in joints])
    return Quadruped(
        name=urdf.robot.name,
        urdf=urdf.text,
        legs=tuple(leg.name for leg in legs),
        joints=tuple(joint.name for joint in joints),
        feet=tuple(leg.foot_name for leg in legs),
        trunk=tree.root,
        lower=ranges[:, 0],
        upper=ranges[:, 1],
        effort=np.array([joint.limit.effort for joint in joints]),
        velocity=np.array([joint.limit.velocity for joint in joints]),
        friction=np.array(
            [float(joint.dynamics.friction or 0) if joint.dynamics else 0.0 for joint in joints]
        ),
        home=np.array(spec.key(HOME).qpos),
        notes=tuple(notes),
        spec=spec,
    )
