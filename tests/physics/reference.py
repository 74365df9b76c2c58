"""What MuJoCo C says of robots, and models of several as one that `jax.vmap` maps over."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from quadwalk.physics.motor import Motor


class ControlStep(NamedTuple):
    """The result of a control step in MuJoCo C."""

    qpos: np.ndarray
    qvel: np.ndarray
    torque: np.ndarray  # (12,) Nm, mean of the physics steps, without friction
    energy: np.ndarray  # () J, positive work of the motors
    touching: set[int]  # geoms that were in contact in any physics step


def step_control(
    model: mujoco.MjModel,
    motor: Motor,
    qpos: np.ndarray,
    qvel: np.ndarray,
    targets: Iterable[np.ndarray],
    encoder: float = 0.0,
) -> ControlStep:
    """Step in MuJoCo C once for each of `targets` (12,), rad, with motors worked out here.

    Joint controllers read joint angles that are `encoder`, rad, too large.
    """
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    torques, energy, touching = [], 0.0, set()
    for target in targets:
        qd = data.qvel[6:].copy()
        torque = motor.kp * (target - (data.qpos[7:] + encoder)) - motor.kd * qd
        limit = motor.effort * np.clip(1 - np.sign(torque) * qd / motor.velocity, 0, 1)
        torque = motor.strength * np.clip(torque, -limit, limit)
        data.qfrc_applied[6:] = torque - motor.friction * np.tanh(qd / 0.1)
        mujoco.mj_step(model, data)
        torques.append(torque)
        speed = (qd + data.qvel[6:]) / 2
        energy += np.maximum(torque * speed, 0).sum() * model.opt.timestep
        touching |= set(data.contact.geom.flat)
    return ControlStep(data.qpos, data.qvel, np.mean(torques, axis=0), np.array(energy), touching)


def place_robot(model: mujoco.MjModel, qpos: np.ndarray) -> mujoco.MjData:
    """The robot in a pose, by MuJoCo's kinematics."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data


def measure_heights(model: mujoco.MjModel, points: np.ndarray) -> list[float]:
    """m, of the heightfield that a model's floor is, at `points` (n, 2), m."""
    data = place_robot(model, model.qpos0 + 10.0 * np.eye(model.nq)[2])  # out of the way
    floor, down = model.geom("floor").id, np.array([0.0, 0.0, -1.0])
    return [
        5.0 - mujoco.mj_rayHfield(model, data, floor, np.array([*point, 5.0]), down, None)
        for point in points
    ]


def compute_accelerations(
    models: Iterable[mujoco.MjModel], qpos: np.ndarray, qvel: np.ndarray, torque: np.ndarray
) -> list[mujoco.MjData]:
    """Of each robot (n, ...) with its model, what MuJoCo computes with joint torques (n, 12)."""
    found = []
    for model, q, v, t in zip(models, qpos, qvel, torque, strict=False):
        found.append(data := mujoco.MjData(model))
        data.qpos[:], data.qvel[:], data.qfrc_applied[6:] = q, v, t
        mujoco.mj_forward(model, data)
    return found


def find_touching(found: Iterable[mujoco.MjData]) -> set[int]:
    """All geoms that are in contact."""
    return {geom for data in found for geom in data.contact.geom.flat}


def stack_models(models: Sequence[Any]) -> tuple[list[np.ndarray], Callable[[Sequence[Any]], Any]]:
    """What differs between models of one structure, any engine's; and how to make one of it.

    Returns the leaves that differ, with the models along axis 0, and a function that takes one
    robot's of these, as within `jax.vmap`, and returns its model: all other leaves are the first's.
    """
    # On the host: MJX ties its arrays to one device, and the robots may be on several.
    rows = [
        list(map(np.asarray, leaves)) for leaves in zip(*map(jax.tree.leaves, models), strict=True)
    ]
    differ = [not all(np.array_equal(row[0], leaf) for leaf in row) for row in rows]
    leaves, structure = jax.tree.flatten(models[0])

    def assemble(given: Sequence[Any]) -> Any:
        rest = iter(given)
        chosen = [next(rest) if own else leaf for own, leaf in zip(differ, leaves, strict=True)]
        return jax.tree.unflatten(structure, chosen)

    return [np.stack(row) for row, own in zip(rows, differ, strict=True) if own], assemble
