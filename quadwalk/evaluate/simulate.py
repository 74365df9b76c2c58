"""Episodes of a policy, stepped as training steps them, in any engine: one judges the other.

An environment differs from that of training in its engine alone. MJX and the engine trained in
step the training model: spheres against the floor only, a fast solver. MuJoCo C steps the full
model: every collision shape, 2 ms steps, a converged solver.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
from brax.envs.base import State

from quadwalk.evaluate.rollout import Rollout
from quadwalk.physics import mujoco_c
from quadwalk.physics.model import vary_motor
from quadwalk.physics.motor import friction_torque, motor_torque
from quadwalk.task.env import QuadrupedEnv
from quadwalk.task.state import EnvState

# Observations (..., n) to actions (..., 12); a pytree (`jax.tree_util.Partial`), so that it can be
# an argument of what is compiled: once for all policies of one shape.
Policy = Callable[[jax.Array], jax.Array]
Report = Callable[[int], None]  # is told how many control steps of the episodes are done

CHUNK = 50  # control steps between looks at whether every episode has ended
GROUP = 512  # episodes at a time, at most: those of 20 s take 0.8 GB of memory
ROOM = 64  # many episodes go in multiples of this, which devices can share


class Frame(NamedTuple):
    """Control steps of a batch of episodes, as recorded: JAX arrays, on the host NumPy's."""

    observation: Any
    action: Any
    target: Any
    qpos: Any
    qvel: Any
    torque: Any
    energy: Any
    contact: Any
    reward: Any
    terms: dict[str, Any]
    command: Any  # None where there is none
    obeyed: Any  # None in an ideal world
    truth: Any  # None in an ideal world
    end: Any


def simulate_episodes(
    env: QuadrupedEnv,
    policy: Policy,
    episodes: int,
    seed: int,
    report: Report | None = None,
    only: int | None = None,
) -> Iterator[Rollout]:
    """Roll `policy` out from `episodes` fresh starts, until each falls or meets the time limit.

    Up to `GROUP` at a time, so that whoever lets go of rollouts needs no more memory for more of
    them. `only`: that one again, in the company it had. The rollouts are without foot forces.
    """

    @env.jit
    def chunk(policy: Policy, state: State) -> tuple[State, Frame]:
        def one_step(state: State, _: None) -> tuple[State, Frame]:
            action = policy(state.obs)
            after = jax.vmap(env.step)(state, action)
            return after, _frame(env, state, action, after)

        return jax.lax.scan(one_step, state, None, length=CHUNK)

    starts, steps = fresh_starts(env, episodes, seed), env.config.episode_steps
    groups = math.ceil(episodes / GROUP)
    # Of one size, for one program; the last begins with some of the one before.
    size = min(ROOM * math.ceil(episodes / groups / ROOM), episodes)

    def of_group(k: int) -> Iterator[Rollout]:
        numbers = range(k * size, min((k + 1) * size, episodes))
        first = numbers.stop - size
        own = jax.tree.map(lambda x: x[first : numbers.stop], starts)
        initial = jax.device_get(own.pipeline_state)
        told = report and (lambda done: report((k * steps + min(done, steps)) // groups))
        chunks = until_all_ended(partial(chunk, policy), over_devices(env, own), told)
        for number in numbers if only is None else [only]:
            yield _rollout(env, initial, chunks, seed, number, number - first)

    for k in range(groups) if only is None else [only // size]:
        yield from of_group(k)


def fresh_starts(env: QuadrupedEnv, episodes: int, seed: int) -> State:
    """The batched `State` of `episodes` fresh episodes; the same for the same seed."""
    keys = jax.random.split(jax.random.PRNGKey(seed), episodes)
    start: State = env.jit(jax.vmap(env.reset))(keys)
    return start


def over_devices(env: QuadrupedEnv, batch: Any) -> Any:
    """`batch`, whose arrays begin with the axis of episodes, shared out between the devices.

    Episodes do not meet, so the compiler can give each device its share of them. MuJoCo C has
    threads of its own.
    """
    devices = jax.devices()
    if env.engine == "mujoco" or len(jax.tree.leaves(batch)[0]) % len(devices):
        return batch
    mesh = jax.sharding.Mesh(np.array(devices), ("episodes",))
    spec = jax.sharding.PartitionSpec("episodes")
    return jax.device_put(batch, jax.sharding.NamedSharding(mesh, spec))


def _frame(env: QuadrupedEnv, before: State, action: jax.Array, state: State) -> Frame:
    prefix = "reward/"
    begun: EnvState = before.pipeline_state
    command, ideal = begun.command, begun.conditions is None
    return Frame(
        observation=before.obs[..., : len(env.observation_names)],
        action=action,
        target=jax.vmap(partial(env.config.action, env.robot))(action, begun.qpos[:, 7:]),
        qpos=state.pipeline_state.qpos,
        qvel=state.pipeline_state.qvel,
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
        obeyed=None if ideal else jax.vmap(env.obeyed)(begun, action),
        truth=None if ideal else jax.vmap(env.truth)(begun),
        end=state.info["end"],
    )


def until_all_ended(
    chunk: Callable[[Any], tuple[Any, Frame]], state: Any, report: Report | None = None
) -> list[Frame]:
    """Repeat `chunk`, state to (state, frames of `CHUNK` steps), until each episode has ended.

    Returns the frames of each chunk, on the host. `report` hears after each.
    """
    chunks: list[Frame] = []
    ended = False
    while not np.all(ended):
        state, frames = chunk(state)
        chunks.append(jax.device_get(frames))
        ended |= (chunks[-1].end > 0).any(axis=0)
        if report is not None:
            report(CHUNK * len(chunks))
    return chunks


def _rollout(
    env: QuadrupedEnv, initial: EnvState, chunks: list[Frame], seed: int, number: int, i: int
) -> Rollout:
    """Row `i` of a batch, which is episode `number`, cut at its end."""
    whole = jax.tree.map(lambda *parts: np.concatenate([x[:, i] for x in parts]), *chunks)
    steps = int(np.argmax(whole.end > 0)) + 1
    one: Frame = jax.tree.map(lambda x: x[:steps], whole)
    qpos = np.concatenate([initial.qpos[None, i], one.qpos]).astype(float)
    qvel = np.concatenate([initial.qvel[None, i], one.qvel]).astype(float)
    return Rollout(
        control_dt=env.config.control_dt,
        seed=seed,
        episode=number,
        end=env.ends[int(one.end[-1])],
        qpos=qpos,
        qvel=qvel,
        action=one.action,
        target=one.target,
        torque=one.torque,
        energy=one.energy,
        observation=one.observation,
        observation_names=env.observation_names,
        contact=one.contact,
        reward_terms=one.terms,
        reward=one.reward,
        command=one.command,
        conditions=jax.tree.map(lambda x: x[i], initial.conditions),
        obeyed=one.obeyed,
        truth=one.truth,
    )


def with_foot_forces(rollout: Rollout, env: QuadrupedEnv) -> Rollout:
    """`rollout` with its `foot_force`, N: the floor's push on each foot, normal to the floor.

    Those of each state, with the motors' torques at that moment, in MuJoCo C on the model that the
    engine stepped. Some 0.2 s for 20 s of running, so it is left to the rollouts that are shown.
    """
    qpos, qvel = rollout.qpos[1:], rollout.qvel[1:]
    motor, joint_speed, model = env.motor, qvel[:, 6:], env.mj_model_of(env.quadruped)
    if rollout.conditions is not None and rollout.conditions.variation is not None:
        motor = vary_motor(motor, rollout.conditions.variation)
        model = mujoco_c.varied_model(model, rollout.conditions.variation)
    target = rollout.target if rollout.obeyed is None else rollout.obeyed
    torque = np.asarray(
        motor_torque(motor, target, qpos[:, 7:], joint_speed) + friction_torque(motor, joint_speed)
    )
    data = mujoco.MjData(model)
    feet = geom_ids(model, env.quadruped.feet)
    forces = np.zeros((rollout.steps, 4))
    for row in range(rollout.steps):
        data.qpos, data.qvel = qpos[row], qvel[row]
        data.qfrc_applied[6:] = torque[row]  # not by actuators, whose limits are the model's own
        mujoco.mj_forward(model, data)
        forces[row] = foot_forces(model, data, feet)
    return dataclasses.replace(rollout, foot_force=forces)


def geom_ids(model: mujoco.MjModel, feet: tuple[str, ...]) -> tuple[int, ...]:
    """The floor's geom and those of `feet`."""
    return tuple(int(model.geom(name).id) for name in ("floor", *feet))


def foot_forces(model: mujoco.MjModel, data: mujoco.MjData, geoms: tuple[int, ...]) -> np.ndarray:
    """(4,) N, the floor's push on each foot along its normal, from the contacts in `data`.

    `geoms` are `geom_ids`.
    """
    floor, *feet = geoms
    column = {foot: k for k, foot in enumerate(feet)}
    forces, contact = np.zeros(4), np.zeros(6)
    for i, (a, b) in enumerate(data.contact.geom[: data.ncon]):
        foot = column.get(int(b) if a == floor else int(a))
        if foot is not None and floor in (a, b):
            # The contact frame's x axis is the floor's normal, up or down.
            mujoco.mj_contactForce(model, data, i, contact)
            forces[foot] += contact[0]
    return forces
