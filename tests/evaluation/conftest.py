"""Rollouts to test on: simulated in MuJoCo C, or drawn to order."""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from quadwalk.evaluation.mcap.foot_forces import compute_foot_forces, find_floor_and_feet
from quadwalk.evaluation.rollout import Rollout
from quadwalk.robot.quadruped import Quadruped
from quadwalk.tasks import sprint

CONTROL_DT, SUBSTEPS = 0.02, 5
KP, KD = 160.0, 4.0  # stiff enough for legs that only follow the clock


def read_messages(path: Path) -> dict[str, list]:
    """Return the messages of an MCAP file by topic: pairs of nanoseconds and message.

    A message is decoded, or bytes if it is no Protobuf. Raises an error for a wrong checksum.
    """
    messages, decoders = defaultdict(list), DecoderFactory()
    with open(path, "rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert message.publish_time == message.log_time
            decode = decoders.decoder_for(channel.message_encoding, schema) or bytes
            messages[channel.topic].append((message.log_time, decode(message.data)))
    return dict(messages)


def count_messages(path: Path) -> int:
    """Return the number of messages in an MCAP file; raise an error for a wrong checksum."""
    return sum(map(len, read_messages(path).values()))


def read_records(path: Path) -> tuple[dict, dict]:
    """Return the metadata and attachments of an MCAP file by their names."""
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        return metadata, {record.name: record for record in reader.iter_attachments()}


def make_glide_poses(start: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return poses (T, 7), m and wxyz, of a trunk that moves from `start` with velocities (T, 3).

    Velocities are in the frame of its heading: m/s ahead and to the left, and rad/s. Poses are
    `CONTROL_DT` apart, the first of them after the first step.
    """
    first = Rotation.from_quat(start[3:7], scalar_first=True)
    heading = Rotation.from_euler("z", first.as_euler("ZYX")[0])
    turns = Rotation.from_euler("z", CONTROL_DT * np.cumsum(velocity[:, 2])[:, None])
    moves = CONTROL_DT * (turns * heading).apply(velocity * [1, 1, 0])
    return np.c_[start[:3] + np.cumsum(moves, axis=0), (turns * first).as_quat(scalar_first=True)]


@pytest.fixture(scope="session")
def simulate(quadruped: Quadruped) -> Callable[..., Rollout]:
    """Return a function that makes the rollout of legs that swing at set phases, in MuJoCo C.

    `offsets` are the legs' phases in strides, in the quadruped's order. PD control follows the
    swing for `steps` control steps; no policy acts.
    """

    def run(
        steps: int,
        offsets: tuple[float, ...] = (0.0, 0.5, 0.5, 0.0),
        frequency: float = 3.0,  # Hz
        sweep: float = -0.25,  # rad, of the thighs
        lift: float = 0.3,  # rad, of the calves
        seed: int = 0,
    ) -> Rollout:
        model = quadruped.make_training_model(CONTROL_DT / SUBSTEPS, iterations=5)
        data = mujoco.MjData(model)
        data.qpos[:] = quadruped.home
        mujoco.mj_forward(model, data)
        geoms = find_floor_and_feet(model, quadruped.feet)
        rng = np.random.default_rng(seed)
        qpos, qvel = [data.qpos.copy()], [data.qvel.copy()]
        rows: dict[str, list] = {name: [] for name in ("target", "torque", "energy", "foot_force")}
        phase_of = 2 * np.pi * np.array(offsets)
        for k in range(steps):
            phase = 2 * np.pi * frequency * k * CONTROL_DT + phase_of
            target = quadruped.home[7:].reshape(4, 3).copy()
            target[:, 1] += sweep * np.cos(phase)
            target[:, 2] -= lift * np.maximum(-np.sin(phase), 0.0)
            target = target.ravel() + 0.01 * rng.standard_normal(12)
            torques, energy = [], 0.0
            for _ in range(SUBSTEPS):
                torque = KP * (target - data.qpos[7:]) - KD * data.qvel[6:]
                data.ctrl[:] = np.clip(torque, -quadruped.effort, quadruped.effort)
                torques.append(data.ctrl.copy())
                power = np.maximum(data.ctrl * data.qvel[6:], 0.0).sum()
                energy += power * model.opt.timestep
                mujoco.mj_step(model, data)
            qpos.append(data.qpos.copy())
            qvel.append(data.qvel.copy())
            rows["target"].append(target)
            rows["torque"].append(np.mean(torques, axis=0))
            rows["energy"].append(energy)
            rows["foot_force"].append(compute_foot_forces(model, data, geoms))
        arrays = {name: np.array(values, dtype=np.float32) for name, values in rows.items()}
        states, rates = np.array(qpos, dtype=np.float32), np.array(qvel, dtype=np.float32)
        actions = ((arrays["target"] - quadruped.home[7:]) / 0.6).astype(np.float32)
        # As many numbers, and as noisy, as a policy sees and as a reward has terms.
        last = np.roll(actions, 1, axis=0)
        observation = np.concatenate([rates[:-1], states[:-1, 2:], last], axis=1)
        terms = dict(zip(sprint.TASK.env.reward, rates[1:].T, strict=False))
        terms["alive"] = np.ones(steps, dtype=np.float32)
        return Rollout(
            control_dt=CONTROL_DT,
            seed=seed,
            episode=0,
            end="time limit",
            qpos=states,
            qvel=rates,
            action=actions,
            observation=observation,
            observation_names=tuple(f"seen {k}" for k in range(observation.shape[1])),
            contact=arrays["foot_force"] > 0,
            reward_terms=terms,
            reward=terms["forward"] + 0.5,
            **arrays,
        )

    return run


@pytest.fixture(scope="session")
def trot(simulate) -> Rollout:
    """Return the rollout of 2 s by `simulate` in which diagonal legs swing together."""
    return simulate(100)


@pytest.fixture(scope="session")
def swaying() -> Callable[[jax.Array], jax.Array]:
    """Return a policy, observation (47,) to action (12,), that moves the legs a little."""
    weights = 0.03 * jax.random.normal(jax.random.PRNGKey(1), (47, 12))
    return jax.tree_util.Partial(lambda w, observation: jnp.tanh(observation @ w), weights)
