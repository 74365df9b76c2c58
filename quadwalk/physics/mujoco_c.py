"""MuJoCo C, on all cores: independent of what learned in JAX.

It steps the model that it is given, usually the full one, in which every shape collides and the
solver converges. A jitted and vmapped control step hands a whole batch of robots to the host.
"""

import copy
import threading
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import mujoco.rollout
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from quadwalk.cores import cpu_cores
from quadwalk.physics import motor
from quadwalk.physics.model import RobotRandomization, randomize_motor
from quadwalk.physics.motor import Effort, Motor, PhysicsState, Stepping
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import field_of
from quadwalk.terrain.windows import Windows

TIMESTEP = 0.002  # s, a physics step of the full model
# MuJoCo's pool of threads is one of the process; devices may call at the same time.
_POOL = threading.Lock()
_CONTROLS = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)


@jax.tree_util.register_static
class Stepper:
    """A MuJoCo model, and a place to compute in for each thread."""

    def __init__(self, model: mujoco.MjModel, quadruped: Quadruped) -> None:
        self.model = model
        self._quadruped = quadruped
        # Of each variation that is in use: its models, by the window of the ground that they have.
        self._varied: dict[bytes, dict[tuple[int, int], mujoco.MjModel]] = {}

    def step(self, states: np.ndarray, torque: np.ndarray, models: Any) -> np.ndarray:
        """`states` (n, 38), time, qpos and qvel, after a step with joint torques (n, 12), Nm.

        `models` are those that `models` gave, about whose origins the places in `states` are.
        """
        applied = np.pad(torque, [(0, 0), (6, 0)])[:, None]
        with _POOL:
            after, _ = mujoco.rollout.rollout(
                models,
                self._data if models is self.model else self._bare_data,
                states,
                applied,
                control_spec=_CONTROLS,
                persistent_pool=True,
            )
        return after[:, 0]

    def models(
        self, variations: RobotRandomization | None, places: np.ndarray
    ) -> tuple[mujoco.MjModel | list[mujoco.MjModel], np.ndarray]:
        """The one model of all robots, or that of each, and where its origin is, (n, 2) m.

        `places` (n, 2), m, are where robots are; `variations` have arrays (n, ...).
        """
        windows, middles = np.zeros(places.shape, int), np.zeros(places.shape)
        if variations is None:
            return self.model, middles
        if self._windows is not None:
            windows = self._windows.under(places)
            middles = self._windows.middles(windows)
        rows = np.concatenate([np.reshape(x, (len(x), -1)) for x in variations], axis=1)
        # None is kept of robots that are gone, nor of where they were.
        before, self._varied = self._varied, {}
        models = []
        for i, (row, window) in enumerate(zip(rows, map(tuple, windows), strict=True)):
            key = row.tobytes()
            own, known = self._varied.setdefault(key, {}), before.get(key, {})
            if window in known:
                own[window] = known[window]
            elif window not in own:
                # Anywhere else it is the same but for its ground.
                elsewhere = next(iter((known | own).values()), None)
                own[window] = self._over(
                    window,
                    elsewhere
                    or randomize_model(self._bare, RobotRandomization(*(x[i] for x in variations))),
                )
            models.append(own[window])
        return models, middles

    def _over(self, window: tuple[int, int], model: mujoco.MjModel) -> mujoco.MjModel:
        """A copy of `model` over another window of the ground."""
        if self._windows is None:
            return model
        model = copy.copy(model)
        self._windows.put(model, window)
        return model

    @cached_property
    def _data(self) -> list[mujoco.MjData]:
        return [mujoco.MjData(self.model) for _ in range(cpu_cores())]

    @cached_property
    def _bare_data(self) -> list[mujoco.MjData]:
        return [mujoco.MjData(self._bare) for _ in range(cpu_cores())]

    @cached_property
    def _windows(self) -> Windows | None:
        field = field_of(self.model)
        return None if field is None else Windows(self.model, field)

    @cached_property
    def _bare(self) -> mujoco.MjModel:
        """The full model without what can only be seen, on a window of its ground."""
        if self._windows is None:
            return self._quadruped.make_full_model(self.model.opt.timestep, visuals=False)
        return self._windows.model_of(self._quadruped, self.model.opt.timestep)


def randomize_model(model: mujoco.MjModel, variation: RobotRandomization) -> mujoco.MjModel:
    """A copy of a quadruped's `model` that differs by `variation`, but for its motors."""
    model = copy.copy(model)
    trunk, legs = model.jnt_bodyid[0], model.jnt_bodyid[1:]
    factor: Any = variation.link_mass
    model.geom_friction[:, 0] = variation.friction
    model.body_mass[:] = randomize_masses(model, variation)
    model.body_ipos[trunk] += variation.trunk_center
    model.body_inertia[legs] *= factor[:, None]
    model.dof_armature[6:] *= variation.armature
    model.dof_damping[6:] *= variation.damping
    # What follows from masses, such as inverse inertias at contacts.
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def randomize_masses(model: mujoco.MjModel, variation: RobotRandomization) -> np.ndarray:
    """kg, of each body of a quadruped's `model` that differs by `variation`."""
    masses: np.ndarray = model.body_mass.copy()
    masses[model.jnt_bodyid[0]] += variation.trunk_mass
    masses[model.jnt_bodyid[1:]] *= variation.link_mass
    return masses


class MujocoModel(NamedTuple):
    """The motors' constants, which may differ from robot to robot, and the model of all robots."""

    motor: Motor
    stepper: Stepper
    variation: RobotRandomization | None = None


def make_model(model: mujoco.MjModel, quadruped: Quadruped, motor: Motor) -> MujocoModel:
    """`model`, made from `quadruped`, to be stepped; robots that vary step the full one."""
    return MujocoModel(motor, Stepper(model, quadruped))


def apply_randomization(model: MujocoModel, variation: RobotRandomization) -> MujocoModel:
    """The constants of one robot that differs by `variation` from that of `model`."""
    return MujocoModel(randomize_motor(model.motor, variation), model.stepper, variation)


def step(
    model: MujocoModel, stepping: Stepping, physics: PhysicsState, target: jax.Array
) -> tuple[PhysicsState, Effort]:
    """One control step; `target` (12,) or (substeps, 12), rad. To be vmapped over robots.

    In double precision from its beginning to its end. A batch that is split between devices is
    gathered and computed once for each of them: leave it on one.
    """
    assert np.isclose(model.stepper.model.opt.timestep, stepping.dt)
    each = jnp.ndim(target) > jnp.ndim(physics.qpos)

    def advance(models: Any, state: PhysicsState, torque: Any) -> PhysicsState:
        rows = np.concatenate([np.zeros_like(state.qpos[:1]), state.qpos, state.qvel]).T
        after: Any = model.stepper.step(rows, torque.T, models).T
        return state._replace(qpos=after[1:20], qvel=after[20:38])

    def step(*leaves: Any) -> list[np.ndarray]:
        # Each (..., its own shape), where ... are the axes vmapped over; then with robots last.
        batch = leaves[-1].shape[: leaves[-1].ndim - (2 if each else 1)]
        several = [x.reshape(-1, *x.shape[len(batch) :]).astype(float) for x in leaves]
        _, variations, *_ = jax.tree.unflatten(structure, several)
        motors, _, state, targets = jax.tree.unflatten(
            structure, [np.moveaxis(x, 0, -1) for x in several]
        )
        models, origins = model.stepper.models(variations, state.qpos[:2].T)
        shift = np.pad(origins.T, [(0, 17), (0, 0)])
        state = state._replace(qpos=state.qpos - shift)
        own = partial(advance, models)
        after, effort = motor.run_control_step(motors, stepping, state, targets, own)
        results: Any = (after.qpos + shift, after.qvel, *effort)
        return [np.moveaxis(x, -1, 0).reshape((*batch, *x.shape[:-1])) for x in results]

    arguments, structure = jax.tree.flatten((model.motor, model.variation, physics, target))
    arguments = [jnp.asarray(x, jnp.float32) for x in arguments]
    shapes = [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in ((19,), (18,), (12,), ())]
    qpos, qvel, torque, energy = _on_host(step, shapes, arguments)
    return PhysicsState(qpos, qvel), Effort(torque, energy)


def _on_host(
    function: Callable[..., list[np.ndarray]], shapes: list[Any], arguments: list[jax.Array]
) -> Any:
    """`function` of NumPy arrays, called once for a whole batch of what is vmapped over."""
    if jax.default_backend() != "cpu":
        return jax.pure_callback(
            lambda *given: [np.float32(x) for x in function(*map(np.asarray, given))],
            shapes,
            *arguments,
            vmap_method="broadcast_all",
        )

    # On a CPU `pure_callback` copies arguments of more than 100 kB by the threads that wait for the
    # callback to end, and so may hang (measured with jax 0.9.2). This one copies none.
    def fill(_: Any, results: Any, *given: Any) -> None:
        for result, value in zip(results, function(*map(np.asarray, given)), strict=True):
            np.asarray(result)[...] = value

    return buffer_callback(fill, shapes, vmap_method="broadcast_all")(*arguments)
