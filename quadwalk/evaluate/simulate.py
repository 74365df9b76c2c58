"""Episodes of a policy, in MJX or in MuJoCo C: the second is the judge of the first.

Both engines share the observation, the action and motor model, the reward and the termination;
only what steps the physics differs. MJX steps the training model: feet only, a fast solver. MuJoCo
C steps the full model: every collision shape, 2 ms steps, a converged solver.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import mujoco.rollout
import numpy as np

from quadwalk.env.actuation import friction_torque, joint_target, motor_torque
from quadwalk.env.physics import Effort, Physics
from quadwalk.env.quadruped import ENDS, EnvState, QuadrupedEnv, conclude
from quadwalk.evaluate.rollout import Rollout
from quadwalk.train.devices import cpu_cores
from quadwalk.train.ppo import AXIS, make_mesh

Engine = Literal["mjx", "mujoco"]
Policy = Callable[[jax.Array], jax.Array]

FULL_TIMESTEP = 0.002  # s, the physics step in MuJoCo C
CHUNK = 50  # control steps between looks at whether every episode has ended


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
    end: Any


def simulate_episodes(
    env: QuadrupedEnv, policy: Policy, episodes: int, seed: int, engine: Engine = "mjx"
) -> list[Rollout]:
    """Roll `policy` out from `episodes` fresh starts, until each falls or meets the time limit."""
    keys = jax.random.split(jax.random.PRNGKey(seed), episodes)
    first = jax.jit(jax.vmap(env.reset))(keys)
    initial = jax.device_get(first.pipeline_state.physics)
    frames = _in_mjx(env, policy, first) if engine == "mjx" else _in_mujoco(env, policy, first)
    model = env.mj_model if engine == "mjx" else env.quadruped.full_model(FULL_TIMESTEP)
    return [_rollout(env, model, initial, frames, seed, i) for i in range(episodes)]


def _frame(observation: jax.Array, action: jax.Array, state: Any) -> Frame:
    prefix = "reward/"
    return Frame(
        observation=observation,
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
        end=state.info["end"],
    )


def _in_mjx(env: QuadrupedEnv, policy: Policy, state: Any) -> Frame:
    """Frames of shape (steps, episodes, ...), on the host."""

    def one_step(state: Any, _: None) -> tuple[Any, Frame]:
        action = policy(state.obs)
        after = jax.vmap(env.step)(state, action)
        return after, _frame(state.obs, action, after)

    mesh = make_mesh()
    if len(state.done) % mesh.size == 0:
        # Episodes do not meet, so the compiler can give each device its share of them.
        split = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec(AXIS))
        state = jax.device_put(state, split)
    chunk = jax.jit(lambda state: jax.lax.scan(one_step, state, None, length=CHUNK))
    return _until_all_ended(env, state, chunk)


def _in_mujoco(env: QuadrupedEnv, policy: Policy, state: Any) -> Frame:
    """Frames of shape (steps, episodes, ...), physics by `mujoco.rollout` on all cores."""
    model = env.quadruped.full_model(FULL_TIMESTEP)
    substeps = max(1, round(env.config.control_dt / FULL_TIMESTEP))
    model.opt.timestep = dt = env.config.control_dt / substeps
    robot, actuation = env.robot, env.config.actuation
    n = len(state.done)

    decide = jax.jit(lambda obs: (action := policy(obs), joint_target(robot, actuation, action)))
    apply = jax.jit(
        lambda target, q, qd: (
            motor_torque(robot, actuation, target, q, qd),
            friction_torque(robot, actuation, qd),
        )
    )
    finish = jax.jit(
        jax.vmap(
            lambda before, action, physics, effort: conclude(
                env.model, robot, env.config, before, action, physics, effort
            )
        )
    )
    spec = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    data = [mujoco.MjData(model) for _ in range(cpu_cores())]

    with mujoco.rollout.Rollout(nthread=len(data)) as engine:

        def chunk(state: Any) -> tuple[Any, Frame]:
            frames = []
            for _ in range(CHUNK):
                action, target = decide(state.obs)
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
                frames.append(_frame(state.obs, action, after))
                state = after
            return state, jax.tree.map(lambda *rows: np.stack(rows), *frames)

        return _until_all_ended(env, state, chunk)


def _until_all_ended(env: QuadrupedEnv, state: Any, chunk: Callable[[Any], Any]) -> Frame:
    chunks: list[Frame] = []
    ended = np.zeros(len(state.done), bool)
    while not ended.all():
        state, frames = chunk(state)
        chunks.append(jax.device_get(frames))
        ended |= (chunks[-1].end > 0).any(axis=0)
    return jax.tree.map(lambda *parts: np.concatenate(parts), *chunks)


def _rollout(
    env: QuadrupedEnv, model: mujoco.MjModel, initial: Physics, frames: Frame, seed: int, i: int
) -> Rollout:
    """Episode `i` of a batch, cut at its end."""
    steps = int(np.argmax(frames.end[:, i] > 0)) + 1
    one: Frame = jax.tree.map(lambda x: x[:steps, i], frames)
    qpos = np.concatenate([initial.qpos[None, i], one.qpos]).astype(float)
    qvel = np.concatenate([initial.qvel[None, i], one.qvel]).astype(float)
    target = np.asarray(joint_target(env.robot, env.config.actuation, one.action))
    return Rollout(
        control_dt=env.config.control_dt,
        seed=seed,
        episode=i,
        end=ENDS[int(one.end[-1])],
        qpos=qpos,
        qvel=qvel,
        action=one.action,
        target=target,
        torque=one.torque,
        energy=one.energy,
        observation=one.observation,
        observation_names=env.observation_names,
        contact=one.contact,
        foot_force=_foot_forces(env, model, qpos[1:], qvel[1:], target),
        reward_terms=one.terms,
        reward=one.reward,
    )


def _foot_forces(
    env: QuadrupedEnv, model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, target: np.ndarray
) -> np.ndarray:
    """Vertical ground reaction (T, 4), N, in each state, with the torques of that moment."""
    actuation = env.config.actuation
    torque = np.asarray(motor_torque(env.robot, actuation, target, qpos[:, 7:], qvel[:, 6:]))
    friction = np.asarray(friction_torque(env.robot, actuation, qvel[:, 6:]))
    data = mujoco.MjData(model)
    column = {model.geom(name).id: k for k, name in enumerate(env.quadruped.feet)}
    floor = model.geom("floor").id
    forces = np.zeros((len(qpos), 4))
    contact = np.zeros(6)
    for row in range(len(qpos)):
        data.qpos, data.qvel = qpos[row], qvel[row]
        data.ctrl, data.qfrc_applied[6:] = torque[row], friction[row]
        mujoco.mj_forward(model, data)
        for i, (a, b) in enumerate(data.contact.geom[: data.ncon]):
            foot = column.get(int(b) if a == floor else int(a))
            if foot is not None and floor in (a, b):
                # The contact frame's x axis is the floor's normal, up or down.
                mujoco.mj_contactForce(model, data, i, contact)
                forces[row, foot] += contact[0]
    return forces
