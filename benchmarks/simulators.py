"""An exported policy in Drake and in MuJoCo C, from the files of its folder alone.

Drake (Tedrake and the Drake Development Team, drake.mit.edu) reads robot.urdf itself, and has
contact and a solver of its own: compliant points with Coulomb friction by SAP (Castro et al. 2022,
arXiv:2110.10107). MuJoCo C reads robot.xml. The export's controller.py drives both, in one loop.
"""

import importlib.util
import logging
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, Protocol

import mujoco
import numpy as np

from quadwalk.export.controller import read_list, to_matrix

Simulator = Literal["Drake", "MuJoCo C"]
PUSH_SECONDS = 2.0  # s, one push in each
GROUND = "ground"
TIPPED = np.cos(1.0)  # a trunk that leans by more than 1 rad fell
LOW = 0.45  # as did one lower than this share of its height at the start
# Sensor noise at level 1: of rates rad/s, attitude rad, joint angles rad, joint rates rad/s.
GYRO, ATTITUDE, ANGLES, RATES = 0.2, 0.05, 0.01, 1.5


@dataclass(frozen=True)
class Condition:
    """What is different from the export's robot and floor in an episode."""

    friction: float | None = None  # of feet and floor; None: as the export states it
    load: float = 0.0  # kg, at the trunk's center of mass
    strength: float = 1.0  # of the motors' torque
    latency: float = 0.0  # s, until a joint target takes effect; the home pose holds before
    noise: float = 0.0  # level of the sensor noise
    push: float = 0.0  # m/s, change of the trunk's velocity in a random direction


@dataclass(frozen=True)
class Contact:
    """How Drake steps and how its contacts yield; None: Drake's own choice."""

    dt: float = 0.002  # s, one physics step
    approximation: Literal["sap", "similar", "lagged"] = "sap"  # of friction and compliance
    stiffness: float | None = None  # N/m, of a point
    dissipation: float | None = None  # s/m, Hunt and Crossley's, of similar and lagged
    relaxation: float | None = None  # s, the dissipation of sap


class Robot(Protocol):
    """A robot on a floor in a simulator: states are MuJoCo's, q (19,) and v (18,)."""

    dt: float  # s, one physics step

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Put the robot into the state `q` (19,), `v` (18,), as MuJoCo defines them."""

    def get_state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the state, q (19,) and v (18,), as MuJoCo defines them."""

    def step(self, torque: np.ndarray) -> None:
        """Take one physics step with joint torques (12,), Nm."""

    def lies(self) -> bool:
        """Return True if the floor touches any link without a foot."""


def load_controller(folder: Path) -> ModuleType:
    """Import the file controller.py of an export's folder; return the module."""
    spec = importlib.util.spec_from_file_location("controller", folder / "controller.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Episode:
    """What happened in T control steps, each before its physics but the last state."""

    qpos: np.ndarray  # (T + 1, 19)
    qvel: np.ndarray  # (T + 1, 18)
    obs: np.ndarray  # (T, n)
    action: np.ndarray  # (T, 12)
    target: np.ndarray  # (T, 12) rad
    fell: bool


class MujocoRobot:
    """robot.xml in MuJoCo C."""

    def __init__(self, folder: Path, about: dict[str, str], condition: Condition) -> None:
        self.model = model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
        self.dt = model.opt.timestep
        model.dof_frictionloss[:] = 0.0  # it is part of the controller's torque
        if condition.friction is not None:
            model.geom_friction[:, 0] = condition.friction
        model.body_mass[model.jnt_bodyid[0]] += condition.load
        self.data = mujoco.MjData(model)
        mujoco.mj_setConst(model, self.data)
        self.floor = model.geom("floor").id
        joints = [model.joint(name) for name in read_list(about["joint_names"])]
        self.ends = {int(model.jnt_bodyid[joint.id]) for joint in joints[2::3]}

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Put the robot into the state `q`, `v`."""
        self.data.qpos[:], self.data.qvel[:] = q, v

    def get_state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the state, q (19,) and v (18,)."""
        return self.data.qpos.copy(), self.data.qvel.copy()

    def step(self, torque: np.ndarray) -> None:
        """Take one physics step with joint torques (12,), Nm."""
        self.data.qfrc_applied[6:] = torque
        mujoco.mj_step(self.model, self.data)

    def lies(self) -> bool:
        """Return True if the floor touches any link without a foot."""
        pairs = self.data.contact.geom[: self.data.ncon]
        with_floor = pairs[(pairs == self.floor).any(axis=1)]
        bodies = {int(body) for body in self.model.geom_bodyid[with_floor].ravel()}
        return bool(bodies - self.ends - {0})


class DrakeRobot:
    """The robot of robot.urdf in Drake; the metadata of policy.onnx give what a URDF lacks."""

    def __init__(
        self,
        folder: Path,
        about: dict[str, str],
        condition: Condition,
        contact: Contact = Contact(),
    ) -> None:
        from pydrake.geometry import HalfSpace
        from pydrake.math import RigidTransform
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import (
            AddMultibodyPlant,
            CoulombFriction,
            MultibodyPlantConfig,
        )
        from pydrake.systems.framework import DiagramBuilder

        # It warns of joint friction, which is the controller's.
        logging.getLogger("drake").setLevel(logging.ERROR)
        self.dt = contact.dt
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=contact.dt,
            discrete_contact_approximation=contact.approximation,
            contact_model="point",
            use_sampled_output_ports=False,
        )
        self.plant, scene = AddMultibodyPlant(config, builder)
        plant = self.plant
        (robot,) = Parser(plant).AddModels(str(folder / "robot.urdf"))
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -float(about["gravity"])])
        joints = [plant.GetJointByName(name) for name in read_list(about["joint_names"])]
        for joint, armature in zip(joints, read_list(about["joint_armature"]), strict=True):
            plant.AddJointActuator(joint.name(), joint).set_default_rotor_inertia(float(armature))
        friction = condition.friction or float(about["ground_friction"])
        plant.RegisterCollisionGeometry(
            plant.world_body(),
            RigidTransform(),
            HalfSpace(),
            GROUND,
            CoulombFriction(friction, friction),
        )
        plant.Finalize()
        _set_contact(plant, scene, friction, contact)
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = plant.GetMyMutableContextFromRoot(self.root)
        self.following = self.diagram.AllocateDiscreteVariables()
        trunk = plant.GetUniqueFloatingBaseBodyOrThrow(robot)
        _add_load(trunk, self.context, condition.load)
        # Drake's positions and velocities in the order of MuJoCo's.
        places = [joint.position_start() for joint in joints]
        self.rates = [joint.velocity_start() for joint in joints]
        self.q_order = np.array([4, 5, 6, 0, 1, 2, 3, *places])
        self.v_order = np.array([3, 4, 5, 0, 1, 2, *self.rates])
        self.forces = plant.get_applied_generalized_force_input_port()
        bodies = [plant.GetBodiesWeldedTo(joint.child_body()) for joint in joints[2::3]]
        ends = [body for group in bodies for body in group] + [plant.world_body()]
        inspector = scene.model_inspector()
        self.others = {
            geometry
            for geometry in inspector.GetAllGeometryIds()
            if plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)) not in ends
        }
        self.ground = next(iter(plant.GetCollisionGeometriesForBody(plant.world_body())))

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Put the robot into the state `q`, `v`, which are MuJoCo's."""
        places, rates = np.zeros(19), np.zeros(18)
        places[self.q_order], rates[self.v_order] = q, v
        rates[:3] = to_matrix(q[3:7]) @ v[3:6]
        self.plant.SetPositions(self.context, places)
        self.plant.SetVelocities(self.context, rates)

    def get_state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the state as MuJoCo defines it, q (19,) and v (18,)."""
        q = self.plant.GetPositions(self.context)[self.q_order]
        v = self.plant.GetVelocities(self.context)[self.v_order]
        v[3:6] = v[3:6] @ to_matrix(q[3:7])  # Drake's is about the world's axes
        return q, v

    def step(self, torque: np.ndarray) -> None:
        """Take one physics step with joint torques (12,), Nm, in the order of MuJoCo's joints."""
        forces = np.zeros(18)
        forces[self.rates] = torque
        self.forces.FixValue(self.context, forces)
        self.diagram.CalcForcedDiscreteVariableUpdate(self.root, self.following)
        self.root.SetDiscreteState(self.following)

    def lies(self) -> bool:
        """Return True if the floor touches any link without a foot."""
        query = self.plant.get_geometry_query_input_port().Eval(self.context)
        pairs = [{pair.id_A, pair.id_B} for pair in query.ComputePointPairPenetration()]
        return any(self.ground in pair and pair & self.others for pair in pairs)


def _set_contact(plant: Any, scene: Any, friction: float, contact: Contact) -> None:
    """Set friction and compliance of every shape in Drake, in place; a URDF does not give them."""
    from pydrake.geometry import AddContactMaterial, ProximityProperties, Role, RoleAssign
    from pydrake.multibody.plant import CoulombFriction

    inspector = scene.model_inspector()
    for geometry in inspector.GetAllGeometryIds(Role.kProximity):
        properties = ProximityProperties(inspector.GetProximityProperties(geometry))
        properties.UpdateProperty(
            "material", "coulomb_friction", CoulombFriction(friction, friction)
        )
        if contact.relaxation is not None:
            properties.UpdateProperty("material", "relaxation_time", contact.relaxation)
        AddContactMaterial(
            properties=properties,
            point_stiffness=contact.stiffness,
            dissipation=contact.dissipation,
        )
        scene.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def _add_load(trunk: Any, context: Any, mass: float) -> None:
    """Add a point mass, kg, at the center of mass of a trunk in Drake, in place."""
    from pydrake.multibody.tree import SpatialInertia

    inertia = trunk.CalcSpatialInertiaInBodyFrame(context)
    center = inertia.get_com()
    central = inertia.Shift(center).CalcRotationalInertia()
    loaded = SpatialInertia.MakeFromCentralInertia(inertia.get_mass() + mass, center, central)
    trunk.SetSpatialInertiaInBodyFrame(context, loaded)


def run_episode(
    robot: Robot,
    controller: Any,
    condition: Condition,
    start: tuple[np.ndarray, np.ndarray],
    commands: np.ndarray,
    seed: int,
) -> Episode:
    """Drive `robot` from `start`, qpos and qvel, by `commands` (T, 3), until it falls.

    Commands are in m/s and rad/s. Of `condition` only latency, noise and pushes are applied here.
    `seed` is that of noise and pushes, which are the same in every simulator until a robot falls.
    """
    rng = np.random.default_rng(seed)
    period = float(controller.about["control_period"])
    substeps, late = round(period / robot.dt), round(condition.latency / robot.dt)
    push_steps = round(PUSH_SECONDS / period)
    targets, rows = [controller.home], []
    controller.restart()
    robot.set_state(*start)
    for number, command in enumerate(commands):
        if number % push_steps == 0:
            push_step, direction = number + rng.integers(push_steps), rng.uniform(0, 2 * np.pi)
        q, v = robot.get_state()
        if number == push_step:
            v[:2] += condition.push * np.array([np.cos(direction), np.sin(direction)])
            robot.set_state(q, v)
        target = controller.compute_targets(*_add_noise(q, v, condition.noise, rng), command)
        targets.append(target)
        rows.append((q, v, controller.obs, controller.action, target))
        for substep in range(substeps):
            # The newest target that is old enough; home before the first of them.
            age = (number * substeps + substep - late) // substeps
            torque = controller.compute_torque(targets[max(1 + age, 0)], *robot.get_state())
            robot.step(torque)
        q, v = robot.get_state()
        fell = to_matrix(q[3:7])[2, 2] < TIPPED or q[2] < LOW * start[0][2] or robot.lies()
        if fell:
            break
    qpos, qvel, obs, action, target = map(np.array, zip(*rows, strict=True))
    return Episode(np.vstack([qpos, q]), np.vstack([qvel, v]), obs, action, target, bool(fell))


def _add_noise(
    q: np.ndarray, v: np.ndarray, noise: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return copies of the state `q` (19,), `v` (18,) as sensors measure it, with random errors.

    Errors of gyroscope, attitude, joint angles and rates are `noise`, a level, times their sizes.
    """
    errors = noise * rng.standard_normal(30)
    quat, q, v = np.zeros(4), q.copy(), v.copy()
    mujoco.mju_mulQuat(quat, q[3:7], np.r_[1.0, ATTITUDE / 2 * errors[:3]])
    q[3:7] = quat / np.linalg.norm(quat)
    q[7:] += ANGLES * errors[6:18]
    v[3:] += np.r_[GYRO * errors[3:6], RATES * errors[18:]]
    return q, v


def run_episodes(
    folder: Path,
    simulator: Simulator,
    condition: Condition,
    starts: list[tuple[np.ndarray, np.ndarray]],
    commands: np.ndarray,
    contact: Contact = Contact(),
) -> list[Episode]:
    """Drive the export in `folder` in one simulator; return an episode from each of `starts`.

    `commands` (n, T, 3), m/s and rad/s, are those of the n episodes. `contact` is Drake's.
    """
    controller = load_controller(folder).Controller(folder / "policy.onnx")
    # Gains and limits alike: a motor's constant.
    controller.kp *= condition.strength
    controller.kd *= condition.strength
    controller.effort_limit *= condition.strength
    if simulator == "Drake":
        robot: Robot = DrakeRobot(folder, controller.about, condition, contact)
    else:
        robot = MujocoRobot(folder, controller.about, condition)
    return [
        run_episode(robot, controller, condition, start, commands[seed], seed)
        for seed, start in enumerate(starts)
    ]
