"""An episode as a stream of messages, in order of time, for viewers to draw and to plot.

Times are simulated nanoseconds. A state is stamped with its own time; what a step produced
(torque, contact, reward) with the time at its end; what the policy saw and commanded with the time
at its start. The `foxglove.*` messages: https://docs.foxglove.dev/docs/sdk/schemas.

Numbers are written to within a millionth of their value (`encoding.compact`).
"""

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message

from quadwalk.evaluation.motion.course import weight_of
from quadwalk.evaluation.motion.kinematics import foot_poses, link_frames, rotations
from quadwalk.evaluation.recording.drawn_urdf import draw_urdf
from quadwalk.evaluation.recording.encoding import (
    Joints,
    Pose,
    Scalars,
    Transforms,
    cdr_string,
    compact,
)
from quadwalk.evaluation.recording.markers import SCENE_PERIOD, SceneWriter, draw_ground
from quadwalk.evaluation.rollout import Rollout, finite_states
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import COMMANDED
from quadwalk.terrain.heightfield import field_of

WORLD = "world"

_BLOCK = 256  # rows turned into messages at a time, so memory does not grow with the episode


class _Writer(Protocol):
    """Fills one message again and again."""

    message: Message

    def serialized(self, time: int, values: Any) -> bytes: ...


class EpisodeMessages:
    """A rollout as (topic, time in ns, bytes), in order of time; `topics` gives their types."""

    def __init__(self, rollout: Rollout, quadruped: Quadruped) -> None:
        if rollout.foot_force is None:
            raise ValueError("a rollout to be written needs its foot forces (with_foot_forces)")
        self.rollout, self.foot_force = rollout, rollout.foot_force
        self.quadruped, self.model = quadruped, quadruped.make_full_model()
        self.rows = finite_states(rollout)
        self.field, self.links = field_of(self.model), link_frames(quadruped)
        joints, names = quadruped.joints, rollout.observation_names
        known = names[: 0 if rollout.truth is None else rollout.truth.shape[1]]
        # What a step begins with, and what fills its messages.
        begun: dict[str, tuple[np.ndarray | None, _Writer]] = {
            "/observation": (rollout.observation, Scalars("Observation", names)),
            "/action": (rollout.action, Scalars("Action", joints)),
            "/truth": (rollout.truth, Scalars("Truth", known)),
            "/command": (rollout.command, Scalars("Command", COMMANDED)),
            "/joint_cmd": (rollout.target, Joints(joints)),
            "/joint_applied_target": (rollout.applied_target, Joints(joints)),
        }
        self.begun = {topic: array for topic, (array, _) in begun.items() if array is not None}
        self.writers = self._writers() | {topic: begun[topic][1] for topic in self.begun}
        self.topics: dict[str, type[Message]] = {
            topic: type(writer.message) for topic, writer in self.writers.items()
        }
        self.topics |= {"/log": Log} | ({} if self.field is None else {"/ground": SceneUpdate})

    def _writers(self) -> dict[str, _Writer]:
        """What fills the messages of each topic of states and of steps that ended in them."""
        rollout, quadruped, legs = self.rollout, self.quadruped, self.quadruped.legs
        path, velocity = rollout.qpos[: self.rows, :3], rollout.qvel[: self.rows, :3]
        weight = weight_of(rollout, self.model)
        frames = [(WORLD, quadruped.trunk), *zip(self.links.parents, self.links.links, strict=True)]
        sensors = [f"{sensor}_{a}" for sensor in ("gyroscope", "accelerometer") for a in "xyz"]
        moved = [f"{frame}_{a}" for frame in ("world", "body") for a in "xyz"]
        return {
            "/tf": Transforms(frames),
            "/joint_states": Joints(quadruped.joints),
            "/pose": Pose(WORLD),
            "/base_velocity": Scalars("BaseVelocity", moved),
            "/imu": Scalars("Imu", ["roll", "pitch", "yaw", *sensors]),
            "/contacts": Scalars("Contacts", [f"{leg}_force" for leg in legs], legs),
            "/reward": Scalars("Reward", ["total", *rollout.reward_terms]),
            "/scene": SceneWriter(path, velocity, weight, WORLD, self.field),
        }

    def nanoseconds(self, row: int) -> int:
        return round(row * self.rollout.control_dt * 1e9)

    def __iter__(self) -> Iterator[tuple[str, int, bytes]]:
        rollout = self.rollout
        yield "/robot_description", 0, cdr_string(draw_urdf(self.quadruped.urdf, self.model))
        if self.field is not None and self.rows:
            path = rollout.qpos[: self.rows, :2].astype(float)
            yield "/ground", 0, draw_ground(self.field, path, WORLD)
        yield self._log(0, Log.INFO, f"reset: episode {rollout.episode}, seed {rollout.seed}")
        for start in range(0, self.rows, _BLOCK):
            yield from self._block(start, min(start + _BLOCK, self.rows))
        yield from self._end()

    def _block(self, start: int, stop: int) -> Iterator[tuple[str, int, bytes]]:
        columns = self._states(start, stop) | self._steps(start, stop) | self._scenes(start, stop)
        for k, row in enumerate(range(start, stop)):
            time = self.nanoseconds(row)
            for topic, rows in columns.items():
                if rows[k] is not None:
                    yield topic, time, self.writers[topic].serialized(time, rows[k])

    def _end(self) -> Iterator[tuple[str, int, bytes]]:
        rollout = self.rollout
        if self.rows <= rollout.steps:
            bad = [
                f"{name}[{index}]"
                for name, array in (("qpos", rollout.qpos), ("qvel", rollout.qvel))
                for index in np.flatnonzero(~np.isfinite(array[self.rows]))
            ]
            shown = ", ".join(bad[:4]) + (f" and {len(bad) - 4} more" if len(bad) > 4 else "")
            yield self._log(self.rows, Log.ERROR, f"nan: {shown} not finite, recording ends")
        elif rollout.fell:
            yield self._log(rollout.steps, Log.WARNING, f"fell: {rollout.end}")
        else:
            yield self._log(rollout.steps, Log.INFO, f"end: {rollout.end}")

    def _log(self, row: int, level: "Log.Level.ValueType", text: str) -> tuple[str, int, bytes]:
        time = self.nanoseconds(row)
        message = Log(level=level, message=text, name="quadwalk")
        message.timestamp.FromNanoseconds(time)
        return "/log", time, message.SerializeToString()

    def _states(self, start: int, stop: int) -> dict[str, list]:
        """Of the states themselves, start .. stop: transforms, joints, pose, velocity, IMU."""
        qpos, qvel = self.rollout.qpos[start:stop], self.rollout.qvel[start:stop]
        base = rotations(qpos[:, 3:7])
        into_body = base.inv()
        # An accelerometer at the base's origin feels the mean acceleration of the step that ended
        # here, less gravity. Before the first step there is none: it stands at rest.
        before = self.rollout.qvel[max(start - 1, 0) : stop - 1, :3]
        before = before if start else np.concatenate([qvel[:1, :3], before])
        felt = (qvel[:, :3] - before) / self.rollout.control_dt + [0, 0, self.quadruped.gravity]
        attitude = base.as_euler("xyz", suppress_warnings=True)
        pose = np.concatenate([qpos[:, :3], base.as_quat(scalar_first=True)], axis=1)
        moved = np.broadcast_to(self.links.translation, (len(qpos), *self.links.translation.shape))
        local = np.concatenate([moved, self.links.rotations(qpos[:, 7:])], axis=2)
        # The torque of the step that ended in this state; none before the first.
        torque = _of_ended(self.rollout.torque, start, stop)
        columns = {
            "/tf": np.concatenate([pose[:, None], local], axis=1),
            "/joint_states": np.stack([qpos[:, 7:], qvel[:, 6:], torque], axis=2),
            "/pose": pose,
            "/base_velocity": np.concatenate([qvel[:, :3], into_body.apply(qvel[:, :3])], axis=1),
            "/imu": np.concatenate([attitude, qvel[:, 3:6], into_body.apply(felt)], axis=1),
        }
        rows = {topic: compact(column).tolist() for topic, column in columns.items()}
        if start == 0:
            rows["/joint_states"][0] = [joint[:2] for joint in rows["/joint_states"][0]]
        return rows

    def _steps(self, start: int, stop: int) -> dict[str, list]:
        """Of the steps that ended in the states start .. stop, then of those that begin there."""
        terms = [self.rollout.reward, *self.rollout.reward_terms.values()]
        forces = compact(_of_ended(self.foot_force, start, stop)).tolist()
        touching = _of_ended(self.rollout.contact, start, stop).tolist()
        rewards = compact(np.stack([_of_ended(term, start, stop) for term in terms], axis=1))
        ended = {
            "/contacts": [force + touch for force, touch in zip(forces, touching, strict=True)],
            "/reward": rewards.tolist(),
        }
        for rows in ended.values():
            rows[: start == 0] = [None] * (start == 0)
        begun = {
            topic: compact(array[start:stop]).tolist() + [None] * (stop > self.rollout.steps)
            for topic, array in self.begun.items()
        }
        return ended | begun

    def _scenes(self, start: int, stop: int) -> dict[str, list]:
        """`/scene` every `SCENE_PERIOD`, and at the last state."""
        every = max(1, round(SCENE_PERIOD / self.rollout.control_dt))
        feet, _ = foot_poses(self.model, self.quadruped.feet, self.rollout.qpos[start:stop])
        carried = _of_ended(self.foot_force, start, stop)
        forces = carried * _of_ended(self.rollout.contact, start, stop)
        rows = [
            None if row % every and row != self.rows - 1 else (row, feet[k], forces[k])
            for k, row in enumerate(range(start, stop))
        ]
        return {"/scene": rows}


def _of_ended(array: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Rows of the steps (T, ...) that ended in the states start .. stop; none ended in state 0."""
    rows = array[max(start - 1, 0) : stop - 1]
    return rows if start else np.concatenate([np.zeros((1, *array.shape[1:]), array.dtype), rows])
