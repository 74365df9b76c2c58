"""Episodes of a policy, in MJX or in MuJoCo C: the second is the judge of the first.

Both engines share the observation, the action and motor model, the reward and the termination;
only what steps the physics differs. MJX steps the training model: spheres against the floor only, a
fast solver. MuJoCo C steps the full model: every collision shape, 2 ms steps, a converged solver.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
import mujoco
import mujoco.rollout
import numpy as np

from quadwalk.evaluate.rollout import Rollout
from quadwalk.physics.mjx_engine import Effort, Physics
from quadwalk.physics.motor import friction_torque, joint_target, motor_torque
from quadwalk.task.command import Command
from quadwalk.task.env import ENDS, EnvState, QuadrupedEnv, conclude
from quadwalk.train.devices import cpu_cores
from quadwalk.train.ppo import AXIS, make_mesh

Engine = Literal["mjx", "mujoco"]
# Observations (..., n) to actions (..., 12); a pytree (`jax.tree_util.Partial`), so that it can be
# an argument of what is compiled: once for all policies of one shape.
Policy = Callable[[jax.Array], jax.Array]
Report = Callable[[int], None]  # is told how many control steps of the episodes are done

FULL_TIMESTEP = 0.002  # s, the physics step in MuJoCo C
CHUNK = 50  # control steps between looks at whether every episode has ended


class Ending(Protocol):
    """What is recorded of control steps, among it how the step ended the episode."""

    @property
    def end(self) -> Any:
        """(steps, episodes) index into `ENDS`."""


Frames = TypeVar("Frames", bound=Ending)


class Frame(NamedTuple):
    """Control steps of a batch of episodes, as recorded: JAX arrays, on the host NumPy's."""

    observation: Any
    action: Any
    qpos: Any
    qvel: Any
    torque: Any
    energy: Any
    contact: Any
    reward: Any
    terms: dict[str, Any]
    command: Any  # None where there is none
    end: Any


def simulate_episodes(
    env: QuadrupedEnv,
    policy: Policy,
    episodes: int,
    seed: int,
    engine: Engine = "mjx",
    report: Report | None = None,
) -> list[Rollout]:
    """Roll `policy` out from `episodes` fresh starts, until each falls or meets the time limit.

    All of them at once. The rollouts are without foot forces.
    """
    first = fresh_starts(env, episodes, seed)
    initial = jax.device_get(first.pipeline_state.physics)
    run = _in_mjx if engine == "mjx" else _in_mujoco
    frames = run(env, policy, first, report)
    return [_rollout(env, initial, frames, seed, i) for i in range(episodes)]


def fresh_starts(env: QuadrupedEnv, episodes: int, seed: int) -> Any:
    """The batched `State` of `episodes` fresh episodes; the same for the same seed."""
    keys = jax.random.split(jax.random.PRNGKey(seed), episodes)
    return jax.jit(jax.vmap(env.reset))(keys)


def engine_model(env: QuadrupedEnv, engine: Engine) -> mujoco.MjModel:
    """The model that `engine` steps."""
    if engine == "mjx":
        return env.mj_model
    model = env.quadruped.full_model(FULL_TIMESTEP)
    # A whole number of physics steps makes a control step.
    model.opt.timestep = env.config.control_dt / max(
        1, round(env.config.control_dt / FULL_TIMESTEP)
    )
    return model


def over_devices(batch: Any, episodes: int) -> Any:
    """`batch`, whose arrays begin with the axis of `episodes`, shared out between the devices.

    Episodes do not meet, so the compiler can give each device its share of them.
    """
    mesh = make_mesh()
    if episodes % mesh.size:
        return batch
    split = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec(AXIS))
    return jax.device_put(batch, split)


def _frame(before: Any, action: jax.Array, state: Any) -> Frame:
    prefix = "reward/"
    command: Command | None = before.pipeline_state.command
    return Frame(
        observation=before.obs,
        action=action,
        qpos=state.pipeline_state.physics.qpos,
        qvel=state.pipeline_state.physics.qvel,
        torque=state.info["torque"],
        energy=state.info["energy"],
        contact=state.info["contact"],
        reward=state.reward,
        terms={
            name.removeprefix(prefix): value
            for name, value in state.metrics.items()
            if name.startswith(prefix)
        },
        command=None if command is None else command.velocity,
        end=state.info["end"],
    )


def _in_mjx(env: QuadrupedEnv, policy: Policy, state: Any, report: Report | None) -> Frame:
    """Frames of shape (steps, episodes, ...), on the host."""

    @jax.jit
    def chunk(policy: Policy, state: Any) -> tuple[Any, Frame]:
        def one_step(state: Any, _: None) -> tuple[Any, Frame]:
            action = policy(state.obs)
            after = jax.vmap(env.step_in_mjx)(state, action)
            return after, _frame(state, action, after)

        return jax.lax.scan(one_step, state, None, length=CHUNK)

    state = over_devices(state, len(state.done))
    return until_all_ended(partial(chunk, policy), state, report)


def _in_mujoco(env: QuadrupedEnv, policy: Policy, state: Any, report: Report | None) -> Frame:
    """Frames of shape (steps, episodes, ...), physics by `mujoco.rollout` on all cores."""
    model = engine_model(env, "mujoco")
    dt = model.opt.timestep
    substeps = round(env.config.control_dt / dt)
    robot, actuation = env.robot, env.config.actuation
    n = len(state.done)

    @jax.jit
    def decide(policy: Policy, state: Any) -> tuple[jax.Array, jax.Array]:
        action = policy(state.obs)
        q = state.pipeline_state.physics.qpos[:, 7:]
        return action, joint_target(robot, actuation, action, q)

    apply = jax.jit(
        lambda target, q, qd: (
            motor_torque(robot, actuation, target, q, qd),
            friction_torque(robot, actuation, qd),
        )
    )
    finish = jax.jit(
        jax.vmap(
            lambda before, action, physics, effort: conclude(
                env.legged, robot, env.config, before, action, physics, effort
            )
        )
    )
    spec = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    data = [mujoco.MjData(model) for _ in range(cpu_cores())]

    with mujoco.rollout.Rollout(nthread=len(data)) as engine:

        def chunk(state: Any) -> tuple[Any, Frame]:
            frames = []
            for _ in range(CHUNK):
                action, target = decide(policy, state)
                before: EnvState = state.pipeline_state
                physical = np.concatenate(
                    [np.zeros((n, 1)), before.physics.qpos, before.physics.qvel], axis=1
                )
                torques, energy = np.zeros((n, 12)), np.zeros(n)
                for _ in range(substeps):
                    q, qd = physical[:, 8:20], physical[:, 26:38]
                    torque, friction = (np.asarray(x, float) for x in apply(target, q, qd))
                    applied = np.concatenate([torque, np.zeros((n, 6)), friction], axis=1)
                    torques += torque / substeps
                    energy += np.maximum(torque * qd, 0.0).sum(axis=1) * dt
                    states, _ = engine.rollout(
                        model, data, physical, applied[:, None], control_spec=spec
                    )
                    physical = states[:, 0]
                physics = Physics(
                    jnp.asarray(physical[:, 1:20], jnp.float32),
                    jnp.asarray(physical[:, 20:38], jnp.float32),
                    before.physics.warmstart,
                )
                effort = Effort(jnp.asarray(torques, jnp.float32), jnp.asarray(energy, jnp.float32))
                after = finish(before, action, physics, effort)
                frames.append(_frame(state, action, after))
                state = after
            return state, jax.tree.map(lambda *rows: np.stack(rows), *frames)

        return until_all_ended(chunk, state, report)


def until_all_ended(
    chunk: Callable[[Any], tuple[Any, Frames]], state: Any, report: Report | None = None
) -> Frames:
    """Repeat `chunk`, state to (state, frames of `CHUNK` steps), until each episode has ended.

    Returns the frames one after another, on the host. `report` hears after each chunk.
    """
    chunks: list[Frames] = []
    ended = False
    while not np.all(ended):
        state, frames = chunk(state)
        chunks.append(jax.device_get(frames))
        ended |= (chunks[-1].end > 0).any(axis=0)
        if report is not None:
            report(CHUNK * len(chunks))
    return jax.tree.map(lambda *parts: np.concatenate(parts), *chunks)


def _rollout(env: QuadrupedEnv, initial: Physics, frames: Frame, seed: int, i: int) -> Rollout:
    """Episode `i` of a batch, cut at its end."""
    steps = int(np.argmax(frames.end[:, i] > 0)) + 1
    one: Frame = jax.tree.map(lambda x: x[:steps, i], frames)
    qpos = np.concatenate([initial.qpos[None, i], one.qpos]).astype(float)
    qvel = np.concatenate([initial.qvel[None, i], one.qvel]).astype(float)
    target = joint_target(env.robot, env.config.actuation, one.action, qpos[:-1, 7:])
    return Rollout(
        control_dt=env.config.control_dt,
        seed=seed,
        episode=i,
        end=ENDS[int(one.end[-1])],
        qpos=qpos,
        qvel=qvel,
        action=one.action,
        target=np.asarray(target),
        torque=one.torque,
        energy=one.energy,
        observation=one.observation,
        observation_names=env.observation_names,
        contact=one.contact,
        reward_terms=one.terms,
        reward=one.reward,
        command=one.command,
    )
