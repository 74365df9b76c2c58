"""The constants of a quadruped that its dynamics need, read from a MuJoCo model."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.physics import vectors as v
from quadwalk.physics.contact import Contact, Limits, Softness
from quadwalk.physics.rigid_body import LINKS, Link, Trunk
from quadwalk.physics.robot_arrays import RobotArrays
from quadwalk.physics.vectors import Matrix, Vector


class Shell(NamedTuple):
    """A collision shape of the trunk, scalars, or of one link of each leg, arrays (4, 1)."""

    link: int | None  # None: the trunk
    kind: Any  # mjtGeom
    centre: Vector  # link frame, m
    axes: tuple[Vector, Vector, Vector]  # the shape's x, y and z in the link's frame
    size: Vector  # MuJoCo's

    def bottom(self, up: Vector) -> Any:
        """Height, m, of the shape's lowest point above the link's origin.

        `up` is the world's vertical in the link's frame.
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
        reach: Any = -jnp.inf
        for kind, value in reaches.items():
            # As a number: NumPy compares no array with an enumeration's member.
            of_kind = self.kind == int(kind)
            if np.any(of_kind):
                reach = jnp.where(of_kind, value, reach)
        return v.dot(up, self.centre) - reach


class Legged(NamedTuple):
    """A quadruped in numbers; the leaves are of one robot, (4, 1) over legs, or scalars."""

    trunk: Trunk
    links: tuple[Link, ...]
    contacts: tuple[Contact, ...]  # the feet first
    limits: tuple[Limits, ...]
    shells: tuple[Shell, ...]
    gravity: Vector


def legged(model: mujoco.MjModel, robot: RobotArrays) -> Legged:
    """Read `model`, whose joint 1 + 3 * leg + i is the i-th of a leg's, from the trunk outwards."""
    joints = 1 + np.arange(12).reshape(4, LINKS)
    bodies = model.jnt_bodyid[joints]
    trunk = int(model.jnt_bodyid[0])
    parents = np.c_[np.full(4, trunk), bodies[:, :-1]]
    assert np.array_equal(model.body_parentid[bodies], parents)
    assert np.all(model.jnt_pos == 0)
    links = tuple(_link(model, bodies[:, i], joints[:, i]) for i in range(LINKS))
    limits = tuple(_limits(model, joints[:, i]) for i in range(LINKS))
    return Legged(
        trunk=Trunk(
            mass=float(model.body_mass[trunk]),
            centre=_vector(model.body_ipos[trunk]),
            inertia=_scalars(_inertia(model, trunk)),
        ),
        links=links,
        contacts=tuple(_contact(model, geoms, bodies) for geoms in robot.contact_geoms),
        limits=limits,
        shells=_shells(model, robot.shell_geoms, trunk, bodies),
        gravity=_vector(model.opt.gravity),
    )


def _column(values: Any) -> np.ndarray:
    """(4, 1) of one number per leg."""
    return np.asarray(values, np.float64).reshape(4, 1)


def _vector(values: Any) -> Vector:
    return tuple(float(x) for x in values)  # type: ignore[return-value]


def _scalars(values: Any) -> tuple[Any, ...]:
    return tuple(float(x) for x in values)


def _columns(values: np.ndarray) -> tuple[np.ndarray, ...]:
    """A column for each of the second axis of `values` (4, n)."""
    return tuple(_column(x) for x in np.asarray(values).T)


def _matrix(values: np.ndarray) -> Matrix:
    """`values` (4, 3, 3)."""
    return tuple(_columns(values[:, i]) for i in range(3))  # type: ignore[return-value]


def _rotation(quat: np.ndarray) -> np.ndarray:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quat)
    return out.reshape(3, 3)


def _inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    """(6,) xx yy zz xy xz yz about the centre of mass, in the body's axes."""
    turn = _rotation(model.body_iquat[body])
    full = turn @ np.diag(model.body_inertia[body]) @ turn.T
    return full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _link(model: mujoco.MjModel, bodies: np.ndarray, joints: np.ndarray) -> Link:
    frames = np.array([_rotation(model.body_quat[body]) for body in bodies])
    axes = model.jnt_axis[joints]
    outer = axes[:, :, None] * axes[:, None, :]
    x, y, z = axes.T
    o = np.zeros(4)
    skew = np.array([[o, -z, y], [z, o, -x], [-y, x, o]]).transpose(2, 0, 1)
    turn = (frames @ outer, frames @ (np.eye(3) - outer), frames @ skew)
    dofs = model.jnt_dofadr[joints]
    return Link(
        offset=_columns(model.body_pos[bodies]),  # type: ignore[arg-type]
        axis=_columns(np.einsum("lij,lj->li", frames, axes)),  # type: ignore[arg-type]
        turn=tuple(_matrix(part) for part in turn),  # type: ignore[arg-type]
        mass=_column(model.body_mass[bodies]),
        centre=_columns(model.body_ipos[bodies]),  # type: ignore[arg-type]
        inertia=_columns(np.array([_inertia(model, body) for body in bodies])),
        armature=_column(model.dof_armature[dofs]),
        damping=_column(np.reshape(model.dof_damping[dofs], (4, -1))[:, 0]),
    )


def _softness(
    model: mujoco.MjModel, solref: np.ndarray, solimp: np.ndarray, inverse_inertia: np.ndarray
) -> Softness:
    """Of `solref` (4, 2), in MuJoCo's time constant and damping ratio, and `solimp` (4, 5)."""
    assert np.all(solref > 0)
    low, high = np.clip(solimp[:, :2], mujoco.mjMINIMP, mujoco.mjMAXIMP).T
    time = np.maximum(solref[:, 0], 2 * model.opt.timestep)
    return Softness(
        stiffness=_column(1 / (high * time * solref[:, 1]) ** 2),
        damping=_column(2 / (high * time)),
        low=_column(low),
        high=_column(high),
        width=_column(solimp[:, 2]),
        middle=_column(np.clip(solimp[:, 3], mujoco.mjMINIMP, mujoco.mjMAXIMP)),
        power=_column(np.maximum(solimp[:, 4], 1)),
        inverse_inertia=_column(inverse_inertia),
    )


def _limits(model: mujoco.MjModel, joints: np.ndarray) -> Limits:
    limited = model.jnt_limited[joints].astype(bool)
    return Limits(
        lower=_column(np.where(limited, model.jnt_range[joints, 0], -np.inf)),
        upper=_column(np.where(limited, model.jnt_range[joints, 1], np.inf)),
        softness=_softness(
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
    data = mujoco.MjData(model)
    friction, solref, solimp = np.zeros(4), np.zeros((4, 2)), np.zeros((4, 5))
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= data.geom_xpos[geoms, 2].max()
    mujoco.mj_forward(model, data)
    for contact in data.contact:
        for leg in np.flatnonzero(np.isin(geoms, contact.geom)):
            friction[leg] = contact.friction[0]
            solref[leg], solimp[leg] = contact.solref, contact.solimp
    edge = model.body_invweight0[own, 0] * (1 + friction**2) * 2 * friction**2
    return Contact(
        link=next((i for i in range(LINKS) if np.array_equal(bodies[:, i], own)), None),
        centre=_columns(model.geom_pos[geoms]),  # type: ignore[arg-type]
        radius=_column(model.geom_size[geoms, 0]),
        friction=_column(friction),
        softness=_softness(model, solref, solimp, edge / model.opt.impratio),
    )


def _shells(
    model: mujoco.MjModel, geoms: np.ndarray, trunk: int, bodies: np.ndarray
) -> tuple[Shell, ...]:
    """The shapes `geoms`, those of the four legs side by side."""
    shells = []
    of_body = {
        body: [g for g in geoms if model.geom_bodyid[g] == body] for body in range(model.nbody)
    }
    for geom in of_body[trunk]:
        rotation = _rotation(model.geom_quat[geom])
        shells.append(
            Shell(
                link=None,
                kind=model.geom_type[geom],
                centre=_vector(model.geom_pos[geom]),
                axes=tuple(_vector(axis) for axis in rotation.T),  # type: ignore[arg-type]
                size=_vector(model.geom_size[geom]),
            )
        )
    for link in range(LINKS):
        own = [of_body[body] for body in bodies[:, link]]
        for i in range(max(map(len, own))):
            # Where a leg has fewer shapes than another, kind -1 has no lowest point.
            there = np.array([i < len(shapes) for shapes in own])
            picked = np.array([shapes[i] if i < len(shapes) else 0 for shapes in own])
            axes = np.array([_rotation(quat).T for quat in model.geom_quat[picked]])
            shells.append(
                Shell(
                    link=link,
                    kind=_column(np.where(there, model.geom_type[picked], -1)),
                    centre=_columns(model.geom_pos[picked]),  # type: ignore[arg-type]
                    axes=tuple(_columns(axes[:, i]) for i in range(3)),  # type: ignore[arg-type]
                    size=_columns(model.geom_size[picked]),  # type: ignore[arg-type]
                )
            )
    return tuple(shells)
