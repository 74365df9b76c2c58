"""An episode as a stream of messages, in order of time, for viewers to draw and to plot.

Times are simulated nanoseconds. A state is stamped with its own time; what a step produced
(torque, contact, reward) with the time at its end; what the policy saw and commanded with the time
at its start. The `foxglove.*` messages: https://docs.foxglove.dev/docs/sdk/schemas.

Numbers are written to within a millionth of their value (`encoding.compact`).
"""

from collections.abc import Callable, Iterator

import lxml.etree
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from quadwalk.evaluate.motion.course import weight_of
from quadwalk.evaluate.motion.kinematics import foot_poses, link_frames, rotations
from quadwalk.evaluate.recording.encoding import Scalars, cdr_string, compact
from quadwalk.evaluate.recording.markers import SCENE_PERIOD, SceneWriter, draw_ground
from quadwalk.evaluate.rollout import Rollout, finite_states
from quadwalk.ground.heightfield import field_of
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import COMMANDED

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


class EpisodeMessages:
    """A rollout as (topic, time in ns, bytes), in order of time; `topics` gives their types."""

    def __init__(self, rollout: Rollout, quadruped: Quadruped) -> None:
        if rollout.foot_force is None:
            raise ValueError("a rollout to be written needs its foot forces (with_foot_forces)")
        self.rollout = rollout
        self.foot_force = rollout.foot_force
        self.quadruped = quadruped
        self.rows = finite_states(rollout)
        legs = quadruped.legs
        self.scalars = {
            "/base_velocity": Scalars(
                "BaseVelocity", [f"{frame}_{a}" for frame in ("world", "body") for a in "xyz"]
            ),
            "/imu": Scalars(
                "Imu",
                ["roll", "pitch", "yaw"]
                + [f"{sensor}_{a}" for sensor in ("gyroscope", "accelerometer") for a in "xyz"],
            ),
            "/contacts": Scalars("Contacts", [f"{leg}_force" for leg in legs], legs),
            "/action": Scalars("Action", quadruped.joints),
            "/observation": Scalars("Observation", rollout.observation_names),
            "/reward": Scalars("Reward", ["total", *rollout.reward_terms]),
        }
        if rollout.truth is not None:
            known = rollout.observation_names[: rollout.truth.shape[1]]
            self.scalars["/truth"] = Scalars("Truth", known)
        if rollout.command is not None:
            self.scalars["/command"] = Scalars("Command", list(COMMANDED))
        self.topics: dict[str, type[Message]] = {
            "/tf": FrameTransforms,
            "/joint_states": JointStates,
            "/joint_cmd": JointStates,
            "/pose": PoseInFrame,
            "/scene": SceneUpdate,
            "/log": Log,
        }
        self.field = field_of(quadruped.full_model())
        if self.field is not None:
            self.topics["/ground"] = SceneUpdate
        if rollout.applied_target is not None:
            self.topics["/joint_applied_target"] = JointStates
        self.topics |= {topic: type(scalars.message) for topic, scalars in self.scalars.items()}

    def nanoseconds(self, row: int) -> int:
        return round(row * self.rollout.control_dt * 1e9)

    def __iter__(self) -> Iterator[tuple[str, int, bytes]]:
        rollout = self.rollout
        yield "/robot_description", 0, cdr_string(drawn_urdf(self.quadruped.urdf))
        if self.field is not None and self.rows:
            path = rollout.qpos[: self.rows, :2].astype(float)
            yield "/ground", 0, draw_ground(self.field, path, WORLD)
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
        rollout, links = self.rollout, link_frames(self.quadruped)
        transforms = FrameTransforms()
        transforms.transforms.add(parent_frame_id=WORLD, child_frame_id=self.quadruped.trunk)
        for parent, link in zip(links.parents, links.links, strict=True):
            transforms.transforms.add(parent_frame_id=parent, child_frame_id=link)
        joint_states, pose = JointStates(), PoseInFrame(frame_id=WORLD)
        for name in self.quadruped.joints:
            joint_states.joints.add(name=name)
        velocity, imu = self.scalars["/base_velocity"], self.scalars["/imu"]

        def write(start: int, stop: int) -> Iterator[list[tuple[str, bytes]]]:
            qpos, qvel = rollout.qpos[start:stop], rollout.qvel[start:stop]
            base, velocities, imus = self._trunk(start, stop)
            moved = np.broadcast_to(links.translation, (len(qpos), *links.translation.shape))
            local = np.concatenate([moved, links.rotations(qpos[:, 7:])], axis=2)
            poses = compact(np.concatenate([base[:, None], local], axis=1)).tolist()
            # The torque of the step that ended in this state; none before the first.
            torque = _of_ended(rollout.torque, start, stop)
            joints = compact(np.stack([qpos[:, 7:], qvel[:, 6:], torque], axis=2)).tolist()
            velocities, imus = compact(velocities).tolist(), compact(imus).tolist()
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
                    ("/base_velocity", velocity.serialized(time, velocities[k])),
                    ("/imu", imu.serialized(time, imus[k])),
                ]

        return write

    def _trunk(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose (n, 7), `/base_velocity` (n, 6) and `/imu` (n, 9) of the states start .. stop."""
        qpos, qvel = self.rollout.qpos[start:stop], self.rollout.qvel[start:stop]
        base = rotations(qpos[:, 3:7])
        into_body = base.inv()
        # An accelerometer at the base's origin feels the mean acceleration of the step that ended
        # here, less gravity. Before the first step there is none: it stands at rest.
        before = self.rollout.qvel[max(start - 1, 0) : stop - 1, :3]
        before = before if start else np.concatenate([qvel[:1, :3], before])
        felt = (qvel[:, :3] - before) / self.rollout.control_dt + [0, 0, self.quadruped.gravity]
        attitude = base.as_euler("xyz", suppress_warnings=True)
        return (
            np.concatenate([qpos[:, :3], base.as_quat(scalar_first=True)], axis=1),
            np.concatenate([qvel[:, :3], into_body.apply(qvel[:, :3])], axis=1),
            np.concatenate([attitude, qvel[:, 3:6], into_body.apply(felt)], axis=1),
        )

    def _step_writer(self) -> _RowWriter:
        """Messages of the step that ended in a state, then of the step that begins there."""
        rollout = self.rollout
        commands = JointStates()
        for name in self.quadruped.joints:
            commands.joints.add(name=name)
        targets = {"/joint_cmd": rollout.target}
        if rollout.applied_target is not None:
            targets["/joint_applied_target"] = rollout.applied_target
        begins = {"/observation": rollout.observation, "/action": rollout.action}
        if rollout.truth is not None:
            begins["/truth"] = rollout.truth
        if rollout.command is not None:
            begins["/command"] = rollout.command
        contacts, reward = self.scalars["/contacts"], self.scalars["/reward"]

        terms = [rollout.reward, *rollout.reward_terms.values()]

        def write(start: int, stop: int) -> Iterator[list[tuple[str, bytes]]]:
            forces = compact(_of_ended(self.foot_force, start, stop)).tolist()
            touching = _of_ended(rollout.contact, start, stop).tolist()
            rewards = [_of_ended(term, start, stop) for term in terms]
            rewards = compact(np.stack(rewards, axis=1)).tolist()
            begun = slice(start, min(stop, rollout.steps))
            angles = {topic: compact(array[begun]).tolist() for topic, array in targets.items()}
            begin = {topic: compact(array[begun]).tolist() for topic, array in begins.items()}
            for k, row in enumerate(range(start, stop)):
                time = self.nanoseconds(row)
                messages = []
                if row > 0:
                    messages += [
                        ("/contacts", contacts.serialized(time, forces[k] + touching[k])),
                        ("/reward", reward.serialized(time, rewards[k])),
                    ]
                if row < rollout.steps:
                    commands.timestamp.FromNanoseconds(time)
                    messages += [
                        (topic, self.scalars[topic].serialized(time, rows[k]))
                        for topic, rows in begin.items()
                    ]
                    for topic, rows in angles.items():
                        for joint, angle in zip(commands.joints, rows[k], strict=True):
                            joint.position = angle
                        messages.append((topic, commands.SerializeToString()))
                yield messages

        return write

    def _scene_writer(self) -> _RowWriter:
        """`/scene` every `SCENE_PERIOD`, and at the last state."""
        rollout = self.rollout
        every = max(1, round(SCENE_PERIOD / rollout.control_dt))
        path, velocity = rollout.qpos[: self.rows, :3], rollout.qvel[: self.rows, :3]
        model, names = self.quadruped.full_model(), self.quadruped.feet
        scene = SceneWriter(path, velocity, weight_of(rollout, model), WORLD, self.field)

        def write(start: int, stop: int) -> Iterator[list[tuple[str, bytes]]]:
            feet, _ = foot_poses(model, names, rollout.qpos[start:stop])
            carried = _of_ended(self.foot_force, start, stop)
            forces = carried * _of_ended(rollout.contact, start, stop)
            for row in range(start, stop):
                if row % every and row != self.rows - 1:
                    yield []
                    continue
                stamp = Timestamp()
                stamp.FromNanoseconds(self.nanoseconds(row))
                k = row - start
                data = scene.serialized(row, stamp, feet[k], forces[k])
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
