"""The constants of a quadruped that its equations of motion need, read from a MuJoCo model."""

import copy
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.physics import vectors as v
from quadwalk.physics.batching import append_axis
from quadwalk.physics.contact import Contact, Limits, SolverParams
from quadwalk.physics.motor import Motor
from quadwalk.physics.rigid_body import LINKS, Link, Trunk
from quadwalk.physics.surface import Ground, make_ground_surface, make_offset_surface
from quadwalk.physics.vectors import Array, Matrix, Vector
from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.scene import SPHERE_NAMES, compute_rotation
from quadwalk.terrain.heightfield import FLOOR, Heightfield, field_of


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Shell:
    """A collision shape of the trunk, scalars, or of one link of each leg, (4,) over legs."""

    link: int | None = field(metadata={"static": True})  # None: the trunk
    # mjtGeom; of four legs, -1 where one has fewer shapes than another: that has no lowest point.
    kind: int | tuple[int, ...] = field(metadata={"static": True})
    center: Vector  # link frame, m
    axes: tuple[Vector, Vector, Vector]  # the shape's x, y and z in the link's frame
    size: Vector  # MuJoCo's
    # Of a box: the axes, longest first, at both ends of which `low_points` looks.
    long: tuple[int, ...] = field(default=(), metadata={"static": True})

    def bottom(self, up: Vector) -> Array:
        """Height, m, of the lowest point above the link's origin; `up` is world z in its frame."""
        x, y, z = (jnp.abs(v.dot(up, axis)) for axis in self.axes)
        a, b, c = self.size
        disc = jnp.sqrt(jnp.maximum(1.0 - z * z, 0.0))
        reaches = {
            mujoco.mjtGeom.mjGEOM_SPHERE: a + 0.0 * z,
            mujoco.mjtGeom.mjGEOM_BOX: a * x + b * y + c * z,
            mujoco.mjtGeom.mjGEOM_CYLINDER: a * disc + b * z,
            mujoco.mjtGeom.mjGEOM_CAPSULE: a + b * z,
        }
        reach: Array = -jnp.inf
        for kind, value in reaches.items():
            # As a number: NumPy compares no array with an enumeration's member.
            of_kind = append_axis(np.equal(self.kind, int(kind)))
            if np.any(of_kind):
                reach = jnp.where(of_kind, value, reach)
        return v.dot(up, self.center) - reach

    def low_points(self, up: Vector) -> list[tuple[Array, Vector]]:
        """Points of the shape that may be the first to touch uneven ground, in the link's frame.

        Each with whether the shape has it. At both ends of what is long, the lowest: `up` is the
        world's vertical in the link's frame.
        """
        a, b, _ = self.size
        end = self.axes[2]
        downwards = v.subtract(v.scale(v.dot(up, end), end), up)  # across a cylinder's axis
        rim = v.scale(a * jax.lax.rsqrt(jnp.maximum(v.dot(downwards, downwards), 1e-12)), downwards)
        ends = [v.add(self.center, v.scale(sign * b, end)) for sign in (-1.0, 1.0)]
        corners = [self.center]
        for axis, (own, half) in enumerate(zip(self.axes, self.size, strict=True)):
            lower = -half * jnp.sign(v.dot(up, own))
            signed = (-half, half) if axis in self.long else (lower,)
            corners = [v.add(corner, v.scale(sign, own)) for corner in corners for sign in signed]
        points = {
            mujoco.mjtGeom.mjGEOM_SPHERE: [v.subtract(self.center, v.scale(a, up))],
            mujoco.mjtGeom.mjGEOM_BOX: corners,
            mujoco.mjtGeom.mjGEOM_CYLINDER: [v.add(point, rim) for point in ends],
            mujoco.mjtGeom.mjGEOM_CAPSULE: [v.subtract(point, v.scale(a, up)) for point in ends],
        }
        return [
            (append_axis(np.equal(self.kind, int(kind))), point)
            for kind, some in points.items()
            if np.any(np.equal(self.kind, int(kind)))
            for point in some
        ]


class RobotRandomization(NamedTuple):
    """What a robot's constants are changed to, or by; numbers, or as given.

    The constraint solver's estimate of inverse inertia (MuJoCo's invweight0), which sets how soft
    contacts are, stays that of the unchanged robot.
    """

    friction: jax.Array | np.ndarray  # sliding friction of floor and robot
    trunk_mass: jax.Array | np.ndarray  # kg, added to the trunk in its center of mass
    trunk_center: jax.Array | np.ndarray  # (3,) m, by which that center is shifted, trunk frame
    link_mass: jax.Array | np.ndarray  # (12,) factors of legs' masses and inertias, joints' order
    strength: jax.Array | np.ndarray  # factor of the motors' torque
    kp: jax.Array | np.ndarray  # factor of the joint controller's position gain
    kd: jax.Array | np.ndarray  # factor of its velocity gain
    joint_friction: jax.Array | np.ndarray  # factor
    damping: jax.Array | np.ndarray  # factor
    armature: jax.Array | np.ndarray  # factor


class Model(NamedTuple):
    """A quadruped in numbers: one robot's, scalars or (4,) over legs, of the motors (12,).

    Any leaf may be a JAX array, and under `jax.vmap` differ from robot to robot; all others are
    constants of the compiled program (see `batching.batch_robots`).
    """

    trunk: Trunk
    links: tuple[Link, ...]
    contacts: tuple[Contact, ...]  # the feet first
    limits: tuple[Limits, ...]
    shells: tuple[Shell, ...]
    gravity: Vector  # m/s^2
    motor: Motor
    ground: Ground | None = None  # None: level, at height 0, without end


def randomize_motor(motor: Motor, variation: RobotRandomization) -> Motor:
    """`motor` of a robot that differs by `variation`."""
    friction = motor.friction
    return motor._replace(
        kp=motor.kp * variation.kp,
        kd=motor.kd * variation.kd,
        strength=motor.strength * variation.strength,
        friction=None if friction is None else friction * variation.joint_friction,
    )


def make_model(model: mujoco.MjModel, quadruped: Quadruped, motor: Motor) -> Model:
    """Read `model`, made from `quadruped`, for the equations; its leaves are constants.

    Its joint 1 + 3 * leg + i is a leg's i-th, from the trunk outwards. A heightfield is its ground.
    """
    feet = quadruped.feet
    joints = 1 + np.arange(12).reshape(4, LINKS)
    bodies = model.jnt_bodyid[joints]
    trunk = int(model.jnt_bodyid[0])
    parents = np.c_[np.full(4, trunk), bodies[:, :-1]]
    assert np.array_equal(model.body_parentid[bodies], parents)
    assert np.all(model.jnt_pos == 0)
    found = Model(
        trunk=Trunk(
            mass=float(model.body_mass[trunk]),
            center=_vector(model.body_ipos[trunk]),
            inertia=tuple(float(x) for x in _inertia(model, trunk)),
        ),
        links=tuple(_link(model, bodies[:, i], joints[:, i]) for i in range(LINKS)),
        contacts=tuple(_contact(model, geoms, bodies) for geoms in find_contact_geoms(model, feet)),
        limits=tuple(_limits(model, joints[:, i]) for i in range(LINKS)),
        shells=_shells(model, find_shell_geoms(model, feet), trunk, bodies),
        gravity=_vector(model.opt.gravity),
        motor=motor,
    )
    ground = field_of(model)
    return found if ground is None else add_ground(found, ground)


def add_ground(model: Model, ground: Heightfield) -> Model:
    """`model` on ground that is not level."""
    contacts, offsets = [], []
    for contact in model.contacts:
        radii = np.broadcast_to(np.asarray(contact.radius), 4)
        different, grids = np.unique(radii, return_inverse=True)
        offsets.append(make_offset_surface(ground, tuple(map(float, different))))
        contacts.append(replace(contact, grids=tuple(map(int, grids))))
    surfaces = Ground(make_ground_surface(ground), tuple(offsets))
    return model._replace(contacts=tuple(contacts), ground=surfaces)


def find_contact_geoms(model: mujoco.MjModel, feet: tuple[str, ...]) -> list[np.ndarray]:
    """(4,) geoms of each kind of sphere that may touch the floor, the feet first."""
    names = [model.geom(i).name for i in range(model.ngeom)]
    kinds = [kind for kind in (feet, *SPHERE_NAMES) if set(kind) <= set(names)]
    return [np.array([names.index(name) for name in kind]) for kind in kinds]


def find_shell_geoms(model: mujoco.MjModel, feet: tuple[str, ...]) -> np.ndarray:
    """Every collision shape (n,) of the robot but its feet."""
    collision = (model.geom_bodyid != 0) & (model.geom_group == 3)
    collision[[model.geom(name).id for name in feet]] = False
    return np.flatnonzero(collision)


def _vector(values: Iterable[float]) -> Vector:
    return v.to_vector(float(x) for x in values)


def _over_legs(values: np.ndarray) -> Vector:
    """A vector (4, 3) of each leg."""
    return v.to_vector(np.asarray(values, np.float64).T)


def _matrix(values: np.ndarray) -> Matrix:
    """A matrix (4, 3, 3) of each leg."""
    x, y, z = (_over_legs(values[:, i]) for i in range(3))
    return x, y, z


def _inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    """(6,) as in `Inertia`, about the center of mass, in the body's axes."""
    turn = compute_rotation(model.body_iquat[body])
    full = turn @ np.diag(model.body_inertia[body]) @ turn.T
    return full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _link(model: mujoco.MjModel, bodies: np.ndarray, joints: np.ndarray) -> Link:
    frames = np.array([compute_rotation(model.body_quat[body]) for body in bodies])
    axes = model.jnt_axis[joints]
    outer = axes[:, :, None] * axes[:, None, :]
    x, y, z = axes.T
    o = np.zeros(4)
    skew = np.array([[o, -z, y], [z, o, -x], [-y, x, o]]).transpose(2, 0, 1)
    fixed, with_cos, with_sin = frames @ outer, frames @ (np.eye(3) - outer), frames @ skew
    dofs = model.jnt_dofadr[joints]
    return Link(
        offset=_over_legs(model.body_pos[bodies]),
        axis=_over_legs(np.einsum("lij,lj->li", frames, axes)),
        turn=(_matrix(fixed), _matrix(with_cos), _matrix(with_sin)),
        mass=model.body_mass[bodies],
        center=_over_legs(model.body_ipos[bodies]),
        inertia=tuple(np.array([_inertia(model, body) for body in bodies]).T),
        armature=model.dof_armature[dofs],
        damping=np.reshape(model.dof_damping[dofs], (4, -1))[:, 0],
    )


def _solver_params(
    model: mujoco.MjModel, solref: np.ndarray, solimp: np.ndarray, inverse_inertia: np.ndarray
) -> SolverParams:
    """Of `solref` (4, 2), in MuJoCo's time constant and damping ratio, and `solimp` (4, 5)."""
    assert np.all(solref > 0)
    low, high = np.clip(solimp[:, :2], mujoco.mjMINIMP, mujoco.mjMAXIMP).T
    time = np.maximum(solref[:, 0], 2 * model.opt.timestep)
    return SolverParams(
        stiffness=1 / (high * time * solref[:, 1]) ** 2,
        damping=2 / (high * time),
        low=low,
        high=high,
        width=solimp[:, 2],
        middle=np.clip(solimp[:, 3], mujoco.mjMINIMP, mujoco.mjMAXIMP),
        power=np.maximum(solimp[:, 4], 1),
        inverse_inertia=inverse_inertia,
    )


def _limits(model: mujoco.MjModel, joints: np.ndarray) -> Limits:
    limited = model.jnt_limited[joints].astype(bool)
    return Limits(
        lower=np.where(limited, model.jnt_range[joints, 0], -np.inf),
        upper=np.where(limited, model.jnt_range[joints, 1], np.inf),
        params=_solver_params(
            model,
            model.jnt_solref[joints],
            model.jnt_solimp[joints],
            model.dof_invweight0[model.jnt_dofadr[joints]],
        ),
    )


def _contact(model: mujoco.MjModel, geoms: np.ndarray, bodies: np.ndarray) -> Contact:
    """MuJoCo is asked what it makes of spheres in the floor: it mixes the two's parameters.

    `geoms` (4,) are on the same link of each leg, which are `bodies` (4, 3), or on the trunk.
    """
    own = model.geom_bodyid[geoms]
    model = _on_plane(model)
    data = mujoco.MjData(model)
    friction, solref, solimp = np.zeros(4), np.zeros((4, 2)), np.zeros((4, 5))
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= data.geom_xpos[geoms, 2].max()
    mujoco.mj_forward(model, data)
    for contact in data.contact:
        for leg in np.flatnonzero(np.isin(geoms, contact.geom)):
            friction[leg] = contact.friction[0]
            solref[leg], solimp[leg] = contact.solref, contact.solimp
    inverse_mass = model.body_invweight0[own, 0]
    return Contact(
        link=next((i for i in range(LINKS) if np.array_equal(bodies[:, i], own)), None),
        center=_over_legs(model.geom_pos[geoms]),
        radius=model.geom_size[geoms, 0],
        friction=friction,
        params=_solver_params(model, solref, solimp, inverse_mass / model.opt.impratio),
    )


def _on_plane(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with its floor as a level plane, of the same friction and softness."""
    floor = model.geom(FLOOR).id
    if model.geom_type[floor] == mujoco.mjtGeom.mjGEOM_PLANE:
        return model
    model = copy.copy(model)
    model.geom_type[floor], model.geom_dataid[floor] = mujoco.mjtGeom.mjGEOM_PLANE, -1
    model.geom_pos[floor], model.geom_size[floor], model.geom_rbound[floor] = 0, 0, 0
    return model


def _longest(size: np.ndarray, number: int) -> tuple[int, ...]:
    """The axes along which a box of `size` (3,) is longest."""
    return tuple(int(axis) for axis in np.argsort(-size)[:number])


def _shells(
    model: mujoco.MjModel, geoms: np.ndarray, trunk: int, bodies: np.ndarray
) -> tuple[Shell, ...]:
    """The shapes `geoms`, those of the four legs side by side."""
    shells = []
    of_body = {
        body: [g for g in geoms if model.geom_bodyid[g] == body] for body in range(model.nbody)
    }
    for geom in of_body[trunk]:
        rotation = compute_rotation(model.geom_quat[geom])
        shells.append(
            Shell(
                link=None,
                kind=int(model.geom_type[geom]),
                center=_vector(model.geom_pos[geom]),
                axes=(_vector(rotation[:, 0]), _vector(rotation[:, 1]), _vector(rotation[:, 2])),
                size=_vector(model.geom_size[geom]),
                long=_longest(model.geom_size[geom], 2),
            )
        )
    for link in range(LINKS):
        own = [of_body[body] for body in bodies[:, link]]
        for i in range(max(map(len, own))):
            there = np.array([i < len(shapes) for shapes in own])
            picked = np.array([shapes[i] if i < len(shapes) else 0 for shapes in own])
            axes = np.array([compute_rotation(quat).T for quat in model.geom_quat[picked]])
            shells.append(
                Shell(
                    link=link,
                    kind=tuple(np.where(there, model.geom_type[picked], -1).tolist()),
                    center=_over_legs(model.geom_pos[picked]),
                    axes=_matrix(axes),
                    size=_over_legs(model.geom_size[picked]),
                    long=_longest(model.geom_size[picked].sum(axis=0), 1),
                )
            )
    return tuple(shells)
