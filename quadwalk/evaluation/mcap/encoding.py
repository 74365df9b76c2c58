"""Encoding of numbers, names and texts as the bytes of messages.

Viewers plot a field by its name: `/reward.forward`, `/observation.FR_hip_joint_position`. So each
channel of scalars has a protobuf type of its own, made at run time, and no anonymous array.
"""

import re
from collections.abc import Iterable, Sequence

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from google.protobuf.message import Message

_FIELD = descriptor_pb2.FieldDescriptorProto
_STAMP = "timestamp"

MANTISSA_BITS = 19  # of a double's 52: numbers are written to within a millionth
_DROPPED_BITS = 52 - MANTISSA_BITS
_HALF = np.uint64(1 << (_DROPPED_BITS - 1))
_MASK = np.uint64((1 << 64) - (1 << _DROPPED_BITS))


def round_mantissa(array: np.ndarray) -> np.ndarray:
    """Return an array as doubles whose mantissas are rounded to `MANTISSA_BITS`.

    Their lower four bytes are zero, which costs next to nothing in a compressed file. The full
    mantissa of a simulated number is noise that no compressor can shorten.
    """
    bits = np.array(array, dtype=np.float64, order="C").view(np.uint64)
    return ((bits + _HALF) & _MASK).view(np.float64)


def encode_text(text: str) -> bytes:
    """Encode `text` as a ROS 2 `std_msgs/msg/String`: CDR header, length with NUL, text."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


class Scalars:
    """A channel of named numbers, then of flags: one message that is filled for each time."""

    def __init__(self, name: str, numbers: Sequence[str], flags: Sequence[str] = ()) -> None:
        self.names = make_field_names([*numbers, *flags])
        self.message = make_message_type(name, self.names, len(flags))()

    def serialize(self, time: int, values: Sequence[float | bool]) -> bytes:
        """Return the message at `time`, ns, with `values`: the numbers, then the flags."""
        self.message.timestamp.FromNanoseconds(time)
        for name, value in zip(self.names, values, strict=True):
            setattr(self.message, name, value)
        return self.message.SerializeToString()


class Transforms:
    """The message `/tf`: the pose (7,), m and wxyz, of each (parent, child) frame."""

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        self.message = FrameTransforms()
        for parent, child in frames:
            self.message.transforms.add(parent_frame_id=parent, child_frame_id=child)

    def serialize(self, time: int, poses: Sequence[Sequence[float]]) -> bytes:
        """Return the message at `time`, ns, with the pose (7,) of each child in its parent."""
        for transform, pose in zip(self.message.transforms, poses, strict=True):
            transform.timestamp.FromNanoseconds(time)
            set_pose(transform.translation, transform.rotation, pose)
        return self.message.SerializeToString()


class Joints:
    """The state of joints: of each its position, rad, or position, speed, rad/s, and torque, Nm."""

    def __init__(self, names: Sequence[str]) -> None:
        self.message = JointStates()
        for name in names:
            self.message.joints.add(name=name)

    def serialize(self, time: int, values: Sequence[float | Sequence[float]]) -> bytes:
        """Return the message at `time`, ns, with the position of each joint, or all its numbers."""
        self.message.timestamp.FromNanoseconds(time)
        for joint, numbers in zip(self.message.joints, values, strict=True):
            numbers = numbers if isinstance(numbers, Sequence) else (numbers,)
            for field, number in zip(("position", "velocity", "effort"), numbers, strict=False):
                setattr(joint, field, number)
        return self.message.SerializeToString()


class Pose:
    """A pose (7,), m and wxyz, in `frame`."""

    def __init__(self, frame: str) -> None:
        self.message = PoseInFrame(frame_id=frame)

    def serialize(self, time: int, pose: Sequence[float]) -> bytes:
        """Return the message at `time`, ns, with this pose."""
        self.message.timestamp.FromNanoseconds(time)
        set_pose(self.message.pose.position, self.message.pose.orientation, pose)
        return self.message.SerializeToString()


def set_pose(position, orientation, values: Sequence[float]) -> None:
    """Set the fields of a position and an orientation to a pose (7,), m and wxyz."""
    position.x, position.y, position.z = values[:3]
    orientation.w, orientation.x, orientation.y, orientation.z = values[3:]


def make_field_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return distinct protobuf identifiers for any texts, in the same order.

    >>> make_field_names(["FR hip", "FR-hip", "2nd", "timestamp"])
    ('FR_hip', 'FR_hip_2', '_2nd', 'timestamp_2')
    """
    identifiers = {_STAMP}
    result = []
    for name in names:
        stem = re.sub(r"[^0-9A-Za-z_]+", "_", name).strip("_") or "value"
        if stem[0].isdigit():
            stem = "_" + stem
        identifier, count = stem, 1
        while identifier.lower() in identifiers:  # readers may map names to one case
            count += 1
            identifier = f"{stem}_{count}"
        identifiers.add(identifier.lower())
        result.append(identifier)
    return tuple(result)


def make_message_type(name: str, fields: Sequence[str], flags: int = 0) -> type[Message]:
    """Make a protobuf class: a `timestamp`, then doubles; the last `flags` fields are bools.

    Its type is `quadwalk.` and `name`. `fields` must be identifiers (`make_field_names`). A private
    pool holds the type, so that one process can write two robots with other observations.
    """
    file = descriptor_pb2.FileDescriptorProto(
        name=f"quadwalk/{name}.proto",
        package="quadwalk",
        syntax="proto3",
        dependency=[timestamp_pb2.DESCRIPTOR.name],
    )
    message = file.message_type.add(name=name)
    message.field.add(
        name=_STAMP,
        number=1,
        type=_FIELD.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
        label=_FIELD.LABEL_OPTIONAL,
    )
    kinds = [_FIELD.TYPE_DOUBLE] * (len(fields) - flags) + [_FIELD.TYPE_BOOL] * flags
    for tag, (field, kind) in enumerate(zip(fields, kinds, strict=True), start=2):
        message.field.add(name=field, number=tag, type=kind, label=_FIELD.LABEL_OPTIONAL)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"quadwalk.{name}"))
