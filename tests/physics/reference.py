"""The robots' motion, contacts and ground in MuJoCo C."""

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
    """Take a physics step in MuJoCo C for each of `targets` (12,), rad, from `qpos` and `qvel`.

    The motors' torques are computed here, by formulas of their own. Joint controllers read joint
    angles that are `encoder`, rad, too large.
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
    """Return MuJoCo's data of the robot at `qpos`, after its kinematics alone."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data


def measure_heights(model: mujoco.MjModel, points: np.ndarray) -> list[float]:
    """Return heights, m, of the heightfield that a model's floor is, at `points` (n, 2), m."""
    data = place_robot(model, model.qpos0 + 10.0 * np.eye(model.nq)[2])  # out of the way
    floor, down = model.geom("floor").id, np.array([0.0, 0.0, -1.0])
    return [
        5.0 - mujoco.mj_rayHfield(model, data, floor, np.array([*point, 5.0]), down, None)
        for point in points
    ]


def compute_accelerations(
    models: Iterable[mujoco.MjModel], qpos: np.ndarray, qvel: np.ndarray, torque: np.ndarray
) -> list[mujoco.MjData]:
    """Return MuJoCo's data, with accelerations, of each robot: it has its own model of `models`.

    States are `qpos` (n, 19) and `qvel` (n, 18), joint torques (n, 12), Nm.
    """
    results = []
    for model, q, v, t in zip(models, qpos, qvel, torque, strict=False):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.qfrc_applied[6:] = q, v, t
        mujoco.mj_forward(model, data)
        results.append(data)
    return results


def find_touching(results: Iterable[mujoco.MjData]) -> set[int]:
    """Return the indices of all geoms that are in contact in any of `results`."""
    return {geom for data in results for geom in data.contact.geom.flat}


def stack_models(models: Sequence[Any]) -> tuple[list[np.ndarray], Callable[[Sequence[Any]], Any]]:
    """Return the leaves that differ between models, robots first, and a function for `jax.vmap`.

    The function makes a model of one robot's leaves; all others are those of the first model. Few
    inputs compile sooner than many.
    """
    leaves, structure = jax.tree.flatten(models[0])
    # On the host: MJX ties its arrays to one device, and the robots may be on several.
    columns = [np.stack(column) for column in zip(*map(jax.tree.leaves, models), strict=True)]
    differing = [i for i, column in enumerate(columns) if np.any(column != column[0])]

    def assemble(robot: Sequence[Any]) -> Any:
        replaced = dict(zip(differing, robot, strict=True))
        return jax.tree.unflatten(structure, [replaced.get(i, x) for i, x in enumerate(leaves)])

    return [columns[i] for i in differing], assemble
