"""An episode as a stream of messages, in order of time, for viewers to draw and to plot.

Times are simulated nanoseconds. A state is stamped with its own time; what a step produced
(torque, contact, reward) with the time at its end; what the policy observed and commanded with the
time at its start. The `foxglove.*` messages: https://docs.foxglove.dev/docs/sdk/schemas.

Numbers are written to within a millionth of their value (`encoding.round_mantissa`).
"""

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message

from quadwalk.evaluation.gait import compute_foot_poses
from quadwalk.evaluation.mcap.encoding import (
    Joints,
    Pose,
    Scalars,
    Transforms,
    encode_text,
    round_mantissa,
)
from quadwalk.evaluation.mcap.scene import SCENE_PERIOD, SceneWriter, draw_ground
from quadwalk.evaluation.mcap.urdf import draw_urdf, find_link_frames
from quadwalk.evaluation.metrics import compute_weight, to_rotations
from quadwalk.evaluation.rollout import Rollout
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import COMMANDED
from quadwalk.terrain.heightfield import read_field

WORLD = "world"


class _Writer(Protocol):
    """A message of one topic that is filled again for each time."""

    message: Message

    def serialize(self, time: int, values: Any) -> bytes:
        """Return the message at `time`, ns, with `values`."""


class EpisodeMessages:
    """A rollout as (topic, time in ns, bytes), in order of time; `topics` gives their types."""

    def __init__(self, rollout: Rollout, quadruped: Quadruped) -> None:
        if rollout.foot_force is None:
            raise ValueError("a rollout to be written needs its foot forces (add_foot_forces)")
        self.rollout, self.foot_force = rollout, rollout.foot_force
        self.quadruped, self.model = quadruped, quadruped.make_full_model()
        self.field, self.links = read_field(self.model), find_link_frames(quadruped)
        # What a step starts with, by topic.
        commanded = {
            "/observation": rollout.observation,
            "/action": rollout.action,
            "/truth": rollout.truth,
            "/command": rollout.command,
            "/joint_cmd": rollout.target,
            "/joint_applied_target": rollout.applied_target,
        }
        self.starting = {topic: rows for topic, rows in commanded.items() if rows is not None}
        writers = self._make_writers()
        self.writers = {
            topic: writer
            for topic, writer in writers.items()
            if topic not in commanded or topic in self.starting
        }
        self.topics: dict[str, type[Message]] = {
            topic: type(writer.message) for topic, writer in self.writers.items()
        }
        self.topics |= {"/log": Log} | ({} if self.field is None else {"/ground": SceneUpdate})

    def _make_writers(self) -> dict[str, _Writer]:
        """Return the writer of each topic that has a message for each state or step, by topic."""
        rollout, joints, legs = self.rollout, self.quadruped.joints, self.quadruped.legs
        names = rollout.observation_names
        true_names = names[: 0 if rollout.truth is None else rollout.truth.shape[1]]
        frames = zip(self.links.parents, self.links.links, strict=True)
        velocities = [f"{frame}_{axis}" for frame in ("world", "body") for axis in "xyz"]
        sensors = [f"{sensor}_{a}" for sensor in ("gyroscope", "accelerometer") for a in "xyz"]
        weight = compute_weight(rollout, self.model)
        path, velocity = rollout.qpos[:, :3], rollout.qvel[:, :3]
        return {
            "/tf": Transforms([(WORLD, self.quadruped.trunk), *frames]),
            "/joint_states": Joints(joints),
            "/pose": Pose(WORLD),
            "/base_velocity": Scalars("BaseVelocity", velocities),
            "/imu": Scalars("Imu", ["roll", "pitch", "yaw", *sensors]),
            "/contacts": Scalars("Contacts", [f"{leg}_force" for leg in legs], legs),
            "/reward": Scalars("Reward", ["total", *rollout.reward_terms]),
            "/scene": SceneWriter(path, velocity, weight, WORLD, self.field),
            "/observation": Scalars("Observation", names),
            "/action": Scalars("Action", joints),
            "/truth": Scalars("Truth", true_names),
            "/command": Scalars("Command", COMMANDED),
            "/joint_cmd": Joints(joints),
            "/joint_applied_target": Joints(joints),
        }

    def __iter__(self) -> Iterator[tuple[str, int, bytes]]:
        rollout = self.rollout
        yield "/robot_description", 0, encode_text(draw_urdf(self.quadruped.urdf, self.model))
        if self.field is not None:
            yield "/ground", 0, draw_ground(self.field, rollout.qpos[:, :2].astype(float), WORLD)
        yield self._log(0, Log.INFO, f"reset: episode {rollout.episode}, seed {rollout.seed}")
        states, ends, scenes = self._list_states(), self._list_ends(), self._list_scenes()
        starts = {topic: round_mantissa(rows) for topic, rows in self.starting.items()}
        for row in range(rollout.steps + 1):
            values = {topic: rows[row] for topic, rows in states.items()}
            if row > 0:
                values |= {topic: rows[row - 1] for topic, rows in ends.items()}
            else:  # no step has ended, whose torque it would be
                values["/joint_states"] = values["/joint_states"][:, :2]
            if row < rollout.steps:
                values |= {topic: rows[row] for topic, rows in starts.items()}
            time = self._to_nanoseconds(row)
            for topic, numbers in values.items():
                yield topic, time, self.writers[topic].serialize(time, numbers.tolist())
            if row in scenes:
                yield "/scene", time, self.writers["/scene"].serialize(time, scenes[row])
        if rollout.fell:
            yield self._log(rollout.steps, Log.WARNING, f"fell: {rollout.end}")
        else:
            yield self._log(rollout.steps, Log.INFO, f"end: {rollout.end}")

    def _to_nanoseconds(self, row: int) -> int:
        """Return the simulated time of state `row`, ns."""
        return round(row * self.rollout.control_dt * 1e9)

    def _log(self, row: int, level: "Log.Level.ValueType", text: str) -> tuple[str, int, bytes]:
        """Return a line of the log at the time of state `row`, as (topic, time, bytes)."""
        time = self._to_nanoseconds(row)
        message = Log(level=level, message=text, name="quadwalk")
        message.timestamp.FromNanoseconds(time)
        return "/log", time, message.SerializeToString()

    def _list_states(self) -> dict[str, np.ndarray]:
        """Return by topic the poses, joints, velocities and IMU of all states, (T + 1, ...)."""
        qpos, qvel = self.rollout.qpos, self.rollout.qvel
        base = to_rotations(qpos[:, 3:7])
        into_body = base.inv()
        # An accelerometer at the base's origin feels the mean acceleration of the step that ended
        # here, less gravity. Before the first step there is none: it stands at rest.
        change = np.diff(qvel[:, :3], axis=0, prepend=qvel[:1, :3])
        felt = change / self.rollout.control_dt + [0, 0, self.quadruped.gravity]
        attitude = base.as_euler("xyz", suppress_warnings=True)
        pose = np.concatenate([qpos[:, :3], base.as_quat(scalar_first=True)], axis=1)
        offsets = np.broadcast_to(
            self.links.translation, (len(qpos), *self.links.translation.shape)
        )
        links = np.concatenate([offsets, self.links.compute_rotations(qpos[:, 7:])], axis=2)
        torque = np.concatenate([np.zeros((1, 12)), self.rollout.torque])
        states = {
            "/tf": np.concatenate([pose[:, None], links], axis=1),
            "/joint_states": np.stack([qpos[:, 7:], qvel[:, 6:], torque], axis=2),
            "/pose": pose,
            "/base_velocity": np.concatenate([qvel[:, :3], into_body.apply(qvel[:, :3])], axis=1),
            "/imu": np.concatenate([attitude, qvel[:, 3:6], into_body.apply(felt)], axis=1),
        }
        return {topic: round_mantissa(rows) for topic, rows in states.items()}

    def _list_ends(self) -> dict[str, np.ndarray]:
        """Return by topic the contacts and rewards at the ends of all steps, (T, ...)."""
        rollout = self.rollout
        contacts = [round_mantissa(self.foot_force), rollout.contact]
        rewards = np.stack([rollout.reward, *rollout.reward_terms.values()], axis=1)
        return {
            "/contacts": np.concatenate([part.astype(object) for part in contacts], axis=1),
            "/reward": round_mantissa(rewards),
        }

    def _list_scenes(self) -> dict[int, tuple[int, np.ndarray, np.ndarray]]:
        """Return scenes for `SceneWriter` by state: one in each `SCENE_PERIOD`, and the last."""
        rollout, last = self.rollout, self.rollout.steps
        every = max(1, round(SCENE_PERIOD / rollout.control_dt))
        rows = list(dict.fromkeys([*range(0, last, every), last]))
        feet, _ = compute_foot_poses(self.model, self.quadruped.feet, rollout.qpos[rows])
        forces = np.concatenate([np.zeros((1, 4)), self.foot_force * rollout.contact])
        return {row: (row, feet[k], forces[row]) for k, row in enumerate(rows)}
