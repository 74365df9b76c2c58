"""The constants of a quadruped's equations of motion, read from a MuJoCo model."""

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
from quadwalk.terrain.heightfield import FLOOR, Heightfield, read_field


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Shell:
    """A collision shape of the trunk, scalars, or of one link of each leg, (4,) over legs."""

    link: int | None = field(metadata={"static": True})  # None: the trunk
    # mjtGeom; of four legs, -1 where one has fewer shapes than another.
    kind: int | tuple[int, ...] = field(metadata={"static": True})
    center: Vector  # link frame, m
    axes: tuple[Vector, Vector, Vector]  # the shape's x, y and z in the link's frame
    size: Vector  # MuJoCo's
    # Of a box: the axes, longest first, at both ends of which `low_points` looks.
    long: tuple[int, ...] = field(default=(), metadata={"static": True})

    def compute_bottom(self, up: Vector) -> Array:
        """Return the height of the lowest point above the link's origin, m.

        `up` is world z in the link's frame. The height is infinite where a leg lacks the shape.
        """
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
            is_kind = self._compare_kind(kind)
            if np.any(is_kind):
                reach = jnp.where(is_kind, value, reach)
        return v.dot(up, self.center) - reach

    def find_low_points(self, up: Vector) -> list[tuple[Array, Vector]]:
        """Return points of the shape that may be the first to touch uneven ground.

        Each is True where a leg has the shape, and the point in the link's frame, m. They are the
        lowest points at both ends of what is long; `up` is world z in the link's frame.
        """
        a, b, _ = self.size
        end = self.axes[2]
        downwards = v.subtract(v.scale(v.dot(up, end), end), up)  # across a cylinder's axis
        rim = v.scale(a * jax.lax.rsqrt(jnp.maximum(v.dot(downwards, downwards), 1e-12)), downwards)
        ends = [v.add(self.center, v.scale(sign * b, end)) for sign in (-1.0, 1.0)]
        corners = [self.center]
        for index, (axis, half) in enumerate(zip(self.axes, self.size, strict=True)):
            lower = -half * jnp.sign(v.dot(up, axis))
            signed = (-half, half) if index in self.long else (lower,)
            corners = [v.add(corner, v.scale(sign, axis)) for corner in corners for sign in signed]
        points = {
            mujoco.mjtGeom.mjGEOM_SPHERE: [v.subtract(self.center, v.scale(a, up))],
            mujoco.mjtGeom.mjGEOM_BOX: corners,
            mujoco.mjtGeom.mjGEOM_CYLINDER: [v.add(point, rim) for point in ends],
            mujoco.mjtGeom.mjGEOM_CAPSULE: [v.subtract(point, v.scale(a, up)) for point in ends],
        }
        return [
            (self._compare_kind(kind), point)
            for kind, points_of_kind in points.items()
            if np.any(self._compare_kind(kind))
            for point in points_of_kind
        ]

    def _compare_kind(self, kind: mujoco.mjtGeom) -> Array:
        """Return True where the shape is a geom of this kind: () for the trunk, (4, 1) for legs."""
        # As a number: NumPy compares no array with an enumeration's member.
        is_kind: Array = append_axis(np.equal(self.kind, int(kind)))
        return is_kind


class RobotRandomization(NamedTuple):
    """Changes of a robot's physical properties; numbers, unless a shape is given.

    The constraint solver's estimate of inverse inertia (MuJoCo's invweight0) stays that of the
    unchanged robot. It sets how soft contacts are.
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
    """The constants of one quadruped: scalars, (4,) over legs, or (12,) for the motors.

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


def randomize_motor(motor: Motor, randomization: RobotRandomization) -> Motor:
    """Return the motors of one robot, changed as `randomization` says."""
    friction = motor.friction
    return motor._replace(
        kp=motor.kp * randomization.kp,
        kd=motor.kd * randomization.kd,
        strength=motor.strength * randomization.strength,
        friction=None if friction is None else friction * randomization.joint_friction,
    )


def make_model(model: mujoco.MjModel, quadruped: Quadruped, motor: Motor) -> Model:
    """Return the constants of `model`, which was made from `quadruped`.

    Joint 1 + 3 * leg + i of `model` must be joint i of that leg, counted from the trunk outwards. A
    heightfield of `model` becomes the ground.
    """
    feet = quadruped.feet
    joints = 1 + np.arange(12).reshape(4, LINKS)
    bodies = model.jnt_bodyid[joints]
    trunk = int(model.jnt_bodyid[0])
    parents = np.c_[np.full(4, trunk), bodies[:, :-1]]
    assert np.array_equal(model.body_parentid[bodies], parents)
    assert np.all(model.jnt_pos == 0)
    constants = Model(
        trunk=Trunk(
            mass=float(model.body_mass[trunk]),
            center=_to_vector(model.body_ipos[trunk]),
            inertia=tuple(float(x) for x in _compute_inertia(model, trunk)),
        ),
        links=tuple(_make_link(model, bodies[:, i], joints[:, i]) for i in range(LINKS)),
        contacts=tuple(
            _make_contact(model, geoms, bodies) for geoms in find_contact_geoms(model, feet)
        ),
        limits=tuple(_make_limits(model, joints[:, i]) for i in range(LINKS)),
        shells=_make_shells(model, find_shell_geoms(model, feet), trunk, bodies),
        gravity=_to_vector(model.opt.gravity),
        motor=motor,
    )
    ground = read_field(model)
    return constants if ground is None else add_ground(constants, ground)


def add_ground(model: Model, ground: Heightfield) -> Model:
    """Return `model` on the heightfield `ground` instead of a level floor."""
    contacts, offsets = [], []
    for contact in model.contacts:
        radii = np.broadcast_to(np.asarray(contact.radius), 4)
        distinct, grids = np.unique(radii, return_inverse=True)
        offsets.append(make_offset_surface(ground, tuple(map(float, distinct))))
        contacts.append(replace(contact, grids=tuple(map(int, grids))))
    surfaces = Ground(make_ground_surface(ground), tuple(offsets))
    return model._replace(contacts=tuple(contacts), ground=surfaces)


def find_contact_geoms(model: mujoco.MjModel, feet: tuple[str, ...]) -> list[np.ndarray]:
    """Return the indices of the spheres that may touch the floor: (4,) of each kind, one per leg.

    The kinds are the feet, called `feet`, then those of `SPHERE_NAMES` that `model` has.
    """
    names = [model.geom(i).name for i in range(model.ngeom)]
    kinds = [kind for kind in (feet, *SPHERE_NAMES) if set(kind) <= set(names)]
    return [np.array([names.index(name) for name in kind]) for kind in kinds]


def find_shell_geoms(model: mujoco.MjModel, feet: tuple[str, ...]) -> np.ndarray:
    """Return the indices (n,) of all collision shapes of the robot except its feet."""
    collision = (model.geom_bodyid != 0) & (model.geom_group == 3)
    collision[[model.geom(name).id for name in feet]] = False
    return np.flatnonzero(collision)


def _to_vector(values: Iterable[float]) -> Vector:
    """Return three numbers as a `Vector`."""
    return v.to_vector(float(x) for x in values)


def _to_leg_vector(values: np.ndarray) -> Vector:
    """Return the vectors of four legs (4, 3) as one `Vector`, whose components are (4,)."""
    return v.to_vector(np.asarray(values, np.float64).T)


def _to_leg_matrix(values: np.ndarray) -> Matrix:
    """Return the matrices of four legs (4, 3, 3) as one `Matrix`, whose components are (4,)."""
    x, y, z = (_to_leg_vector(values[:, i]) for i in range(3))
    return x, y, z


def _compute_inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Return xx, yy, zz, xy, xz, yz of a body's inertia about its center of mass, in its axes."""
    turn = compute_rotation(model.body_iquat[body])
    full = turn @ np.diag(model.body_inertia[body]) @ turn.T
    return full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _make_link(model: mujoco.MjModel, bodies: np.ndarray, joints: np.ndarray) -> Link:
    """Return the constants of one link of each leg; `bodies` and `joints` are indices (4,)."""
    frames = np.array([compute_rotation(model.body_quat[body]) for body in bodies])
    axes = model.jnt_axis[joints]
    outer = axes[:, :, None] * axes[:, None, :]
    x, y, z = axes.T
    o = np.zeros(4)
    skew = np.array([[o, -z, y], [z, o, -x], [-y, x, o]]).transpose(2, 0, 1)
    fixed, with_cos, with_sin = frames @ outer, frames @ (np.eye(3) - outer), frames @ skew
    dofs = model.jnt_dofadr[joints]
    return Link(
        offset=_to_leg_vector(model.body_pos[bodies]),
        axis=_to_leg_vector(np.einsum("lij,lj->li", frames, axes)),
        turn=(_to_leg_matrix(fixed), _to_leg_matrix(with_cos), _to_leg_matrix(with_sin)),
        mass=model.body_mass[bodies],
        center=_to_leg_vector(model.body_ipos[bodies]),
        inertia=tuple(np.array([_compute_inertia(model, body) for body in bodies]).T),
        armature=model.dof_armature[dofs],
        damping=np.reshape(model.dof_damping[dofs], (4, -1))[:, 0],
    )


def _compute_solver_params(
    model: mujoco.MjModel, solref: np.ndarray, solimp: np.ndarray, inverse_inertia: np.ndarray
) -> SolverParams:
    """Return the constants of `solref` (4, 2), time constant and damping ratio, and `solimp`.

    The formulas are those of "Solver parameters" in MuJoCo's documentation.
    """
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


def _make_limits(model: mujoco.MjModel, joints: np.ndarray) -> Limits:
    """Return the position limits of one joint of each leg; `joints` are indices (4,)."""
    limited = model.jnt_limited[joints].astype(bool)
    return Limits(
        lower=np.where(limited, model.jnt_range[joints, 0], -np.inf),
        upper=np.where(limited, model.jnt_range[joints, 1], np.inf),
        params=_compute_solver_params(
            model,
            model.jnt_solref[joints],
            model.jnt_solimp[joints],
            model.dof_invweight0[model.jnt_dofadr[joints]],
        ),
    )


def _make_contact(model: mujoco.MjModel, geoms: np.ndarray, bodies: np.ndarray) -> Contact:
    """Return the constants of one kind of sphere, `geoms` (4,).

    They are on the same link of each leg, of `bodies` (4, 3), or on the trunk. MuJoCo mixes the
    parameters of sphere and floor, so its contacts are read.
    """
    carriers = model.geom_bodyid[geoms]
    model = _replace_floor(model)
    data = mujoco.MjData(model)
    friction, solref, solimp = np.zeros(4), np.zeros((4, 2)), np.zeros((4, 5))
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= data.geom_xpos[geoms, 2].max()
    mujoco.mj_forward(model, data)
    for contact in data.contact:
        for leg in np.flatnonzero(np.isin(geoms, contact.geom)):
            friction[leg] = contact.friction[0]
            solref[leg], solimp[leg] = contact.solref, contact.solimp
    inverse_mass = model.body_invweight0[carriers, 0]
    return Contact(
        link=next((i for i in range(LINKS) if np.array_equal(bodies[:, i], carriers)), None),
        center=_to_leg_vector(model.geom_pos[geoms]),
        radius=model.geom_size[geoms, 0],
        friction=friction,
        params=_compute_solver_params(model, solref, solimp, inverse_mass / model.opt.impratio),
    )


def _replace_floor(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return the model with a level plane as its floor, of the same friction and softness."""
    floor = model.geom(FLOOR).id
    if model.geom_type[floor] == mujoco.mjtGeom.mjGEOM_PLANE:
        return model
    model = copy.copy(model)
    model.geom_type[floor], model.geom_dataid[floor] = mujoco.mjtGeom.mjGEOM_PLANE, -1
    model.geom_pos[floor], model.geom_size[floor], model.geom_rbound[floor] = 0, 0, 0
    return model


def _find_longest_axes(size: np.ndarray, number: int) -> tuple[int, ...]:
    """Return the `number` axes along which a box of `size` (3,) is longest."""
    return tuple(int(axis) for axis in np.argsort(-size)[:number])


def _make_shells(
    model: mujoco.MjModel, geoms: np.ndarray, trunk: int, bodies: np.ndarray
) -> tuple[Shell, ...]:
    """Return the shapes with indices `geoms`; four that the legs have alike become one, (4,)."""
    shells = []
    by_body = [geoms[model.geom_bodyid[geoms] == body] for body in range(model.nbody)]
    for geom in by_body[trunk]:
        x, y, z = compute_rotation(model.geom_quat[geom]).T
        shells.append(
            Shell(
                link=None,
                kind=int(model.geom_type[geom]),
                center=_to_vector(model.geom_pos[geom]),
                axes=(_to_vector(x), _to_vector(y), _to_vector(z)),
                size=_to_vector(model.geom_size[geom]),
                long=_find_longest_axes(model.geom_size[geom], 2),
            )
        )
    for link in range(LINKS):
        by_leg = [by_body[body] for body in bodies[:, link]]
        for i in range(max(map(len, by_leg))):
            exists = np.array([i < len(shapes) for shapes in by_leg])
            geom_ids = np.array([shapes[i] if i < len(shapes) else 0 for shapes in by_leg])
            axes = np.array([compute_rotation(quat).T for quat in model.geom_quat[geom_ids]])
            shells.append(
                Shell(
                    link=link,
                    kind=tuple(np.where(exists, model.geom_type[geom_ids], -1).tolist()),
                    center=_to_leg_vector(model.geom_pos[geom_ids]),
                    axes=_to_leg_matrix(axes),
                    size=_to_leg_vector(model.geom_size[geom_ids]),
                    long=_find_longest_axes(model.geom_size[geom_ids].sum(axis=0), 1),
                )
            )
    return tuple(shells)
