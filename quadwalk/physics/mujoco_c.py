"""The engine MuJoCo C, on all cores.

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

from quadwalk.cores import count_cores
from quadwalk.physics import motor
from quadwalk.physics.model import RobotRandomization, randomize_motor
from quadwalk.physics.motor import Effort, Motor, PhysicsState, Stepping
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import read_field
from quadwalk.terrain.windows import Windows

TIMESTEP = 0.002  # s, a physics step of the full model
# MuJoCo's pool of threads is one of the process; devices may call at the same time.
_POOL = threading.Lock()
_CONTROLS = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)


@jax.tree_util.register_static
class Stepper:
    """A MuJoCo model, models of robots that are randomized, and the data of each thread."""

    def __init__(self, model: mujoco.MjModel, quadruped: Quadruped) -> None:
        self.model = model
        self._quadruped = quadruped
        # Models in use: by robot, and then by the window of the ground that they have.
        self._models: dict[bytes, dict[tuple[int, int], mujoco.MjModel]] = {}

    def step(self, states: np.ndarray, torque: np.ndarray, models: Any) -> np.ndarray:
        """Return `states` (n, 38), time, qpos and qvel, one physics step later.

        `torque` (n, 12), Nm, is that of the joints. `models` comes from `find_models`; positions in
        `states` are relative to the origins that it returns.
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

    def find_models(
        self, randomizations: RobotRandomization | None, places: np.ndarray
    ) -> tuple[mujoco.MjModel | list[mujoco.MjModel], np.ndarray]:
        """Return the one model of all robots, or each robot's in a list, and origins (n, 2), m.

        `places` (n, 2), m, are those of the robots in the world; `randomizations` have arrays (n,
        ...), or are None for robots that are all alike.
        """
        windows, origins = np.zeros(places.shape, int), np.zeros(places.shape)
        if randomizations is None:
            return self.model, origins
        if self._windows is not None:
            windows = self._windows.find_windows(places)
            origins = self._windows.compute_middles(windows)
        rows = np.concatenate([np.reshape(x, (len(x), -1)) for x in randomizations], axis=1)
        # Models of earlier robots and places are dropped.
        earlier, self._models = self._models, {}
        models = []
        for i, (row, window) in enumerate(zip(rows, map(tuple, windows), strict=True)):
            robot = row.tobytes()
            by_window = self._models.setdefault(robot, {})
            available = earlier.get(robot, {}) | by_window
            model = available.get(window)
            if model is None:
                # Over another window it is the same but for its ground.
                model = next(iter(available.values()), None) or randomize_model(
                    self._bare, RobotRandomization(*(x[i] for x in randomizations))
                )
                model = self._copy_over_window(model, window)
            by_window[window] = model
            models.append(model)
        return models, origins

    def _copy_over_window(self, model: mujoco.MjModel, window: tuple[int, int]) -> mujoco.MjModel:
        """Return a copy of `model` with the ground of the window with these indices; see `Windows`.

        On a level floor it is `model` itself.
        """
        if self._windows is None:
            return model
        model = copy.copy(model)
        self._windows.put_window(model, window)
        return model

    @cached_property
    def _data(self) -> list[mujoco.MjData]:
        """Data of `model`, one for each thread."""
        return [mujoco.MjData(self.model) for _ in range(count_cores())]

    @cached_property
    def _bare_data(self) -> list[mujoco.MjData]:
        """Data of the models of randomized robots, one for each thread."""
        return [mujoco.MjData(self._bare) for _ in range(count_cores())]

    @cached_property
    def _windows(self) -> Windows | None:
        """Windows of the ground; None on a level floor."""
        field = read_field(self.model)
        return None if field is None else Windows(self.model, field)

    @cached_property
    def _bare(self) -> mujoco.MjModel:
        """The full model from which those of randomized robots are copied.

        It is small, because there are many copies: it lacks the visual shapes, and has only as much
        ground as a window; see `Windows`.
        """
        if self._windows is None:
            return self._quadruped.make_full_model(self.model.opt.timestep, visuals=False)
        return self._windows.make_model(self._quadruped, self.model.opt.timestep)


def randomize_model(model: mujoco.MjModel, randomization: RobotRandomization) -> mujoco.MjModel:
    """Return a copy of a quadruped's `model`, changed as `randomization` says, but for motors."""
    model = copy.copy(model)
    trunk, legs = model.jnt_bodyid[0], model.jnt_bodyid[1:]
    factor: Any = randomization.link_mass
    model.geom_friction[:, 0] = randomization.friction
    model.body_mass[:] = compute_randomized_masses(model, randomization)
    model.body_ipos[trunk] += randomization.trunk_center
    model.body_inertia[legs] *= factor[:, None]
    model.dof_armature[6:] *= randomization.armature
    model.dof_damping[6:] *= randomization.damping
    # What follows from masses, such as inverse inertias at contacts.
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def compute_randomized_masses(
    model: mujoco.MjModel, randomization: RobotRandomization
) -> np.ndarray:
    """Return the mass of each body, (nbody,) kg, of `model` changed as `randomization` says.

    `model` is that of a quadruped, and stays as it is.
    """
    masses: np.ndarray = model.body_mass.copy()
    masses[model.jnt_bodyid[0]] += randomization.trunk_mass
    masses[model.jnt_bodyid[1:]] *= randomization.link_mass
    return masses


class MujocoModel(NamedTuple):
    """The motors' constants, which may differ from robot to robot, and the model of all robots."""

    motor: Motor
    stepper: Stepper
    randomization: RobotRandomization | None = None


def make_model(model: mujoco.MjModel, quadruped: Quadruped, motor: Motor) -> MujocoModel:
    """Return the engine's model; randomized robots are stepped with the full model."""
    return MujocoModel(motor, Stepper(model, quadruped))


def apply_randomization(model: MujocoModel, randomization: RobotRandomization) -> MujocoModel:
    """Return the engine's model of one robot, changed as `randomization` says; see `Engine`."""
    motor = randomize_motor(model.motor, randomization)
    return MujocoModel(motor, model.stepper, randomization)


def step(
    model: MujocoModel, stepping: Stepping, physics: PhysicsState, target: jax.Array
) -> tuple[PhysicsState, Effort]:
    """Advance one robot by a control step, computed in double precision; see `Engine`.

    A batch that is split between devices is gathered and computed once for each of them: leave it
    on one.
    """
    assert np.isclose(model.stepper.model.opt.timestep, stepping.dt)
    many_targets = jnp.ndim(target) > jnp.ndim(physics.qpos)

    def advance(models: Any, state: PhysicsState, torque: Any) -> PhysicsState:
        rows = np.concatenate([np.zeros_like(state.qpos[:1]), state.qpos, state.qvel]).T
        after: Any = model.stepper.step(rows, torque.T, models).T
        return state._replace(qpos=after[1:20], qvel=after[20:38])

    def step_batch(*leaves: Any) -> list[np.ndarray]:
        # Each (..., one robot's shape), where ... are the axes vmapped over; then robots last.
        batch = leaves[-1].shape[: leaves[-1].ndim - (2 if many_targets else 1)]
        rows = [x.reshape(-1, *x.shape[len(batch) :]).astype(float) for x in leaves]
        _, randomizations, *_ = jax.tree.unflatten(structure, rows)
        motors, _, state, targets = jax.tree.unflatten(
            structure, [np.moveaxis(x, 0, -1) for x in rows]
        )
        models, origins = model.stepper.find_models(randomizations, state.qpos[:2].T)
        shift = np.pad(origins.T, [(0, 17), (0, 0)])
        state = state._replace(qpos=state.qpos - shift)
        after, effort = motor.run_control_step(
            motors, stepping, state, targets, partial(advance, models)
        )
        results: Any = (after.qpos + shift, after.qvel, *effort)
        return [np.moveaxis(x, -1, 0).reshape((*batch, *x.shape[:-1])) for x in results]

    arguments, structure = jax.tree.flatten((model.motor, model.randomization, physics, target))
    arguments = [jnp.asarray(x, jnp.float32) for x in arguments]
    shapes = [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in ((19,), (18,), (12,), ())]
    qpos, qvel, torque, energy = _call_on_host(step_batch, shapes, arguments)
    return PhysicsState(qpos, qvel), Effort(torque, energy)


def _call_on_host(
    function: Callable[..., list[np.ndarray]], shapes: list[Any], arguments: list[jax.Array]
) -> Any:
    """Return what `function`, of NumPy arrays, returns for `arguments`, in a compiled program.

    Under `jax.vmap` it is called once for the whole batch. `shapes` are those of the result.
    """
    if jax.default_backend() != "cpu":
        return jax.pure_callback(
            lambda *arrays: [np.float32(x) for x in function(*map(np.asarray, arrays))],
            shapes,
            *arguments,
            vmap_method="broadcast_all",
        )

    # On a CPU `pure_callback` copies arguments of more than 100 kB by the threads that wait for the
    # callback to end, and so may hang (measured with jax 0.9.2). This one copies none.
    def fill(_: Any, results: Any, *arrays: Any) -> None:
        for result, value in zip(results, function(*map(np.asarray, arrays)), strict=True):
            np.asarray(result)[...] = value

    return buffer_callback(fill, shapes, vmap_method="broadcast_all")(*arguments)
