"""An episode as a stream of messages, in order of time, for viewers to draw and to plot.

Times are simulated nanoseconds. A state is stamped with its own time; what a step produced
(torque, contact, reward) with the time at its end; what the policy saw and asked for with the time
at its start. The `foxglove.*` messages: https://docs.foxglove.dev/docs/sdk/schemas.

Numbers are written to within a millionth of their value (`precision.compact`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import lxml.etree
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from quadwalk.evaluate import kinematics
from quadwalk.evaluate.recording.markers import SCENE_PERIOD, SceneWriter
from quadwalk.evaluate.recording.precision import compact
from quadwalk.evaluate.recording.typed import field_names, message_type
from quadwalk.evaluate.rollout import Rollout
from quadwalk.robot.quadruped import Quadruped

WORLD = "world"

_BLOCK = 256  # rows turned into messages at a time, so memory does not grow with the episode

# For the rows start .. stop: the (topic, bytes) of each.
_RowWriter = Callable[[int, int], Iterator[list[tuple[str, bytes]]]]


def drawn_urdf(urdf: str) -> str:
    """The URDF for a viewer: without the collision shapes of links that have visual ones.

    Rerun draws both, one through the other. A link without visuals keeps its collision shapes.
    """
    root = lxml.etree.fromstring(urdf.encode())
    for link in root.iter("link"):
        if link.find("visual") is not None:
            for collision in link.findall("collision"):
                link.remove(collision)
    return lxml.etree.tostring(root, encoding="unicode")


def cdr_string(text: str) -> bytes:
    """A ROS 2 `std_msgs/msg/String`: CDR header (little-endian), length with its NUL, text."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


@dataclass(frozen=True)
class _Typed:
    """A channel of named scalars: the message that is filled again and again."""

    message: Message
    numbers: tuple[str, ...]
    flags: tuple[str, ...] = ()

    def serialised(self, time: int, numbers: list[float], flags: list[bool] | None = None) -> bytes:
        self.message.timestamp.FromNanoseconds(time)
        for name, value in zip(self.numbers, numbers, strict=True):
            setattr(self.message, name, value)
        for name, flag in zip(self.flags, flags or (), strict=True):
            setattr(self.message, name, flag)
        return self.message.SerializeToString()


def _typed(name: str, numbers: Sequence[str], flags: Sequence[str] = ()) -> _Typed:
    names = field_names([*numbers, *flags])
    first, rest = names[: len(numbers)], names[len(numbers) :]
    return _Typed(message_type(name, first, rest)(), first, rest)


class EpisodeMessages:
    """A rollout as (topic, time in ns, bytes), in order of time; `topics` gives their types."""

    def __init__(self, rollout: Rollout, quadruped: Quadruped) -> None:
        if rollout.foot_force is None:
            raise ValueError("a rollout to be written needs its foot forces (with_foot_forces)")
        self.rollout = rollout
        self.foot_force = rollout.foot_force
        self.quadruped = quadruped
        self.tree = kinematics.read_tree(quadruped.urdf, tuple(quadruped.joints))
        finite = np.isfinite(rollout.qpos).all(axis=1) & np.isfinite(rollout.qvel).all(axis=1)
        self.rows = len(finite) if finite.all() else int(np.argmin(finite))
        legs = list(quadruped.legs)
        axes = "xyz"
        self.typed = {
            "/base_velocity": _typed(
                "BaseVelocity",
                [f"world_{a}" for a in axes] + [f"body_{a}" for a in axes],
            ),
            "/imu": _typed(
                "Imu",
                ["roll", "pitch", "yaw"]
                + [f"gyroscope_{a}" for a in axes]
                + [f"accelerometer_{a}" for a in axes],
            ),
            "/contacts": _typed("Contacts", [f"{leg}_force" for leg in legs], legs),
            "/action": _typed("Action", list(quadruped.joints)),
            "/observation": _typed("Observation", list(rollout.observation_names)),
            "/reward": _typed("Reward", ["total", *rollout.reward_terms]),
        }
        if rollout.command is not None:
            self.typed["/command"] = _typed("Command", ["forward", "sideways", "turning"])
        self.topics: dict[str, type[Message]] = {
            "/tf": FrameTransforms,
            "/joint_states": JointStates,
            "/joint_cmd": JointStates,
            "/pose": PoseInFrame,
            "/scene": SceneUpdate,
            "/log": Log,
        } | {topic: type(typed.message) for topic, typed in self.typed.items()}

    def nanoseconds(self, row: int) -> int:
        return round(row * self.rollout.control_dt * 1e9)

    def __iter__(self) -> Iterator[tuple[str, int, bytes]]:
        rollout = self.rollout
        yield "/robot_description", 0, cdr_string(drawn_urdf(self.quadruped.urdf))
        yield self._log(0, Log.INFO, f"reset: episode {rollout.episode}, seed {rollout.seed}")
        states, steps, scene = self._state_writer(), self._step_writer(), self._scene_writer()
        for start in range(0, self.rows, _BLOCK):
            stop = min(start + _BLOCK, self.rows)
            for row, in_row in zip(
                range(start, stop),
                zip(states(start, stop), steps(start, stop), scene(start, stop), strict=True),
                strict=True,
            ):
                time = self.nanoseconds(row)
                for messages in in_row:
                    for topic, data in messages:
                        yield topic, time, data
        yield from self._end()

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

    def _state_writer(self) -> _RowWriter:
        """Messages of the states themselves: transforms, joints, pose, velocity, IMU."""
        rollout, tree = self.rollout, self.tree
        names, gravity = self.quadruped.joints, self.quadruped.gravity
        transforms = FrameTransforms()
        transforms.transforms.add(parent_frame_id=WORLD, child_frame_id=tree.root)
        for joint in tree.joints:
            transforms.transforms.add(parent_frame_id=joint.parent, child_frame_id=joint.child)
        joint_states, pose = JointStates(), PoseInFrame(frame_id=WORLD)
        for name in names:
            joint_states.joints.add(name=name)
        velocity, imu = self.typed["/base_velocity"], self.typed["/imu"]

        def write(start: int, stop: int) -> Iterator[list[tuple[str, bytes]]]:
            qpos, qvel = rollout.qpos[start:stop], rollout.qvel[start:stop]
            quat = kinematics.quat_normalised(qpos[:, 3:7])
            inverse = kinematics.quat_conjugate(quat)
            base = np.concatenate([qpos[:, :3], quat], axis=1)
            links = np.concatenate(kinematics.local_poses(tree, qpos[:, 7:]), axis=2)
            poses = compact(np.concatenate([base[:, None], links], axis=1)).tolist()
            # The torque of the step that ended in this state; none before the first.
            torque = _of_ended(rollout.torque, start, stop)
            joints = compact(np.stack([qpos[:, 7:], qvel[:, 6:], torque], axis=2)).tolist()
            body_velocity = kinematics.rotate(inverse, qvel[:, :3])
            velocities = np.concatenate([qvel[:, :3], body_velocity], axis=1)
            velocities = compact(velocities).tolist()
            # An accelerometer at the base's origin feels the mean acceleration of the step that
            # ended here, less gravity. Before the first step there is none: it stands at rest.
            before = rollout.qvel[max(start - 1, 0) : stop - 1, :3]
            before = before if start else np.concatenate([qvel[:1, :3], before])
            felt = (qvel[:, :3] - before) / rollout.control_dt + [0.0, 0.0, gravity]
            felt = kinematics.rotate(inverse, felt)
            imus = np.concatenate([kinematics.rpy_from_quat(quat), qvel[:, 3:6], felt], axis=1)
            imus = compact(imus).tolist()
            for k, row in enumerate(range(start, stop)):
                time = self.nanoseconds(row)
                stamp = Timestamp()
                stamp.FromNanoseconds(time)
                for transform, values in zip(transforms.transforms, poses[k], strict=True):
                    transform.timestamp.CopyFrom(stamp)
                    _set_pose(transform.translation, transform.rotation, values)
                joint_states.timestamp.CopyFrom(stamp)
                for joint, (angle, rate, effort) in zip(
                    joint_states.joints, joints[k], strict=True
                ):
                    joint.position, joint.velocity = angle, rate
                    if row > 0:
                        joint.effort = effort
                pose.timestamp.CopyFrom(stamp)
                _set_pose(pose.pose.position, pose.pose.orientation, poses[k][0])
                yield [
                    ("/tf", transforms.SerializeToString()),
                    ("/joint_states", joint_states.SerializeToString()),
                    ("/pose", pose.SerializeToString()),
                    ("/base_velocity", velocity.serialised(time, velocities[k])),
                    ("/imu", imu.serialised(time, imus[k])),
                ]

        return write

    def _step_writer(self) -> _RowWriter:
        """Messages of the step that ended in a state, then of the step that begins there."""
        rollout = self.rollout
        commands = JointStates()
        for name in self.quadruped.joints:
            commands.joints.add(name=name)
        begins = {"/observation": rollout.observation, "/action": rollout.action}
        if rollout.command is not None:
            begins["/command"] = rollout.command
        contacts, reward = self.typed["/contacts"], self.typed["/reward"]

        terms = [rollout.reward, *rollout.reward_terms.values()]

        def write(start: int, stop: int) -> Iterator[list[tuple[str, bytes]]]:
            forces = compact(_of_ended(self.foot_force, start, stop)).tolist()
            touching = _of_ended(rollout.contact, start, stop).tolist()
            rewards = [_of_ended(term, start, stop) for term in terms]
            rewards = compact(np.stack(rewards, axis=1)).tolist()
            begun = slice(start, min(stop, rollout.steps))
            targets = compact(rollout.target[begun]).tolist()
            begin = {topic: compact(array[begun]).tolist() for topic, array in begins.items()}
            for k, row in enumerate(range(start, stop)):
                time = self.nanoseconds(row)
                messages = []
                if row > 0:
                    messages += [
                        ("/contacts", contacts.serialised(time, forces[k], touching[k])),
                        ("/reward", reward.serialised(time, rewards[k])),
                    ]
                if row < rollout.steps:
                    commands.timestamp.FromNanoseconds(time)
                    for joint, target in zip(commands.joints, targets[k], strict=True):
                        joint.position = target
                    messages += [
                        (topic, self.typed[topic].serialised(time, rows[k]))
                        for topic, rows in begin.items()
                    ]
                    messages.append(("/joint_cmd", commands.SerializeToString()))
                yield messages

        return write

    def _scene_writer(self) -> _RowWriter:
        """`/scene` every `SCENE_PERIOD`, and at the last state."""
        rollout = self.rollout
        every = max(1, round(SCENE_PERIOD / rollout.control_dt))
        path = rollout.qpos[: self.rows, :3]
        scene = SceneWriter(path, weight=self.tree.mass * self.quadruped.gravity, world=WORLD)

        def write(start: int, stop: int) -> Iterator[list[tuple[str, bytes]]]:
            poses = kinematics.world_poses(self.tree, rollout.qpos[start:stop])
            feet = kinematics.foot_positions(self.tree, poses)
            carried = _of_ended(self.foot_force, start, stop)
            forces = carried * _of_ended(rollout.contact, start, stop)
            for row in range(start, stop):
                if row % every and row != self.rows - 1:
                    yield []
                    continue
                stamp = Timestamp()
                stamp.FromNanoseconds(self.nanoseconds(row))
                k = row - start
                data = scene.serialised(row, stamp, rollout.qvel[row, :3], feet[k], forces[k])
                yield [("/scene", data)]

        return write


def _of_ended(array: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Rows of the steps (T, ...) that ended in the states start .. stop; none ended in state 0."""
    rows = array[max(start - 1, 0) : stop - 1]
    return (
        rows if start else np.concatenate([np.zeros_like(array, shape=(1, *array.shape[1:])), rows])
    )


def _set_pose(position, orientation, values: list[float]) -> None:
    position.x, position.y, position.z = values[0], values[1], values[2]
    orientation.w, orientation.x, orientation.y, orientation.z = values[3:7]
