"""Protobuf message types made at run time: one named field per quantity.

Viewers plot a field by its name (`/reward.forward`, `/observation.FR_hip_joint_position`), so each
channel gets its own type instead of an anonymous array, and without any .proto file to generate.
"""

import re
from collections.abc import Iterable, Sequence

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from google.protobuf.message import Message

_FIELD = descriptor_pb2.FieldDescriptorProto
_STAMP = "timestamp"


def field_names(names: Iterable[str]) -> tuple[str, ...]:
    """Distinct protobuf identifiers for any distinct or repeated texts, in the same order.

    >>> field_names(["FR hip", "FR-hip", "2nd", "timestamp"])
    ('FR_hip', 'FR_hip_2', '_2nd', 'timestamp_2')
    """
    taken = {_STAMP}
    result = []
    for name in names:
        stem = re.sub(r"[^0-9A-Za-z_]+", "_", name).strip("_") or "value"
        if stem[0].isdigit():
            stem = "_" + stem
        chosen, count = stem, 1
        while chosen.lower() in taken:  # readers may map names to one case
            count += 1
            chosen = f"{stem}_{count}"
        taken.add(chosen.lower())
        result.append(chosen)
    return tuple(result)


def message_type(name: str, numbers: Sequence[str], bools: Sequence[str] = ()) -> type[Message]:
    """The class of `quadwalk.<name>`: a `timestamp`, then double fields, then bool fields.

    The field names must be identifiers (`field_names`). A private pool holds the type, so two
    robots with other observations can be written by one process.
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
    kinds = [_FIELD.TYPE_DOUBLE] * len(numbers) + [_FIELD.TYPE_BOOL] * len(bools)
    for tag, (field, kind) in enumerate(zip((*numbers, *bools), kinds, strict=True), start=2):
        message.field.add(name=field, number=tag, type=kind, label=_FIELD.LABEL_OPTIONAL)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"quadwalk.{name}"))
