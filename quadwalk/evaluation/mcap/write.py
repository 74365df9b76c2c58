"""Writing an episode as an MCAP file that Rerun, Foxglove and PlotJuggler open as it is.

Nothing in the file depends on the clock, so two writes of one rollout are byte-identical.
The format: https://mcap.dev/spec.
"""

import gzip
import json
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import IO

from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from quadwalk.cli.shell import find_program, quote_words
from quadwalk.evaluation.mcap.messages import EpisodeMessages
from quadwalk.evaluation.rollout import Rollout
from quadwalk.files import open_atomic
from quadwalk.paths import ASSETS
from quadwalk.robot.quadruped import Quadruped

LAYOUT = ASSETS / "foxglove_layout.json"
RERUN_BLUEPRINT = ASSETS / "rerun.rbl"  # written by benchmarks/rerun_blueprint.py
RERUN_APPLICATION = "quadwalk"  # Rerun applies a blueprint to recordings of its application

# Under 256 KiB zstd takes parameters for small inputs, which suit these messages better.
_CHUNK = 250_000  # bytes
# The format compresses messages but not attachments: one larger than this is stored as NAME.gz.
_LARGE = 16 * 1024  # bytes
_MEDIA_TYPES = {
    ".gz": "application/gzip",
    ".json": "application/json",
    ".urdf": "application/xml",
    ".xml": "application/xml",
    ".png": "image/png",
    ".txt": "text/plain",
}


def write_mcap(
    path: str | Path,
    rollout: Rollout,
    quadruped: Quadruped,
    metadata: Mapping[str, str],
    attachments: Mapping[str, bytes] | None = None,
) -> None:
    """Write one episode to `path`; the file is either whole, or not there.

    `metadata` becomes the record named `quadwalk`; a record `episode` comes from the rollout. The
    URDF and the Foxglove layout are attached, and `attachments` (name -> content) beside them,
    large ones as NAME.gz. Raises `UserError` where the file cannot be written.
    """
    attached = {
        f"{quadruped.name}.urdf": quadruped.urdf.encode(),
        LAYOUT.name: make_foxglove_layout(quadruped.trunk),
        **(attachments or {}),
    }
    episode = {
        "robot": quadruped.name,
        "seed": str(rollout.seed),
        "episode": str(rollout.episode),
        "end": rollout.end,
        "steps": str(rollout.steps),
        "control_dt": repr(float(rollout.control_dt)),
    }
    records = {"episode": episode, "quadwalk": dict(metadata)}
    with open_atomic(path) as file:
        _write(file, EpisodeMessages(rollout, quadruped), attached, records)


def make_foxglove_layout(trunk: str) -> bytes:
    """Return the layout to import in Foxglove, its camera following the link named `trunk`."""
    layout = json.loads(LAYOUT.read_bytes())
    layout["configById"]["3D!robot"]["followTf"] = trunk
    return json.dumps(layout, separators=(",", ":"), allow_nan=False).encode()


def format_rerun_commands(recording: Path) -> str:
    """Return the shell commands that show `recording` in Rerun with the blueprint beside it.

    Rerun takes a blueprint only for a recording with an application, which an MCAP file lacks. Its
    simulated seconds are then dates of 1970.
    """
    converted = recording.with_suffix(".rrd")
    options = ["--application-id", RERUN_APPLICATION, "--timeline-type", "duration"]
    rerun = find_program("rerun")
    convert = quote_words(rerun, "mcap", "convert", *options, recording, "-o", converted)
    show = quote_words(rerun, converted, recording.with_name(RERUN_BLUEPRINT.name))
    return f"{convert} && {show}"


def _write(
    stream: IO[bytes],
    episode: EpisodeMessages,
    attachments: Mapping[str, bytes],
    records: Mapping[str, Mapping[str, str]],
) -> None:
    """Write an episode's messages, attachments and metadata `records` to `stream` as MCAP."""
    writer = Writer(stream, chunk_size=_CHUNK, enable_data_crcs=True)
    writer.start(library="quadwalk")
    # All channels, in a fixed order.
    text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    channels = {"/robot_description": writer.register_channel("/robot_description", "cdr", text)}
    schemas: dict[str, int] = {}
    for topic, kind in episode.topics.items():
        name = kind.DESCRIPTOR.full_name
        if name not in schemas:
            schemas[name] = register_schema(writer, kind)
        channels[topic] = writer.register_channel(topic, "protobuf", schemas[name])
    for name, record in records.items():
        writer.add_metadata(name, dict(sorted(record.items())))
    for name, content in sorted(attachments.items()):
        if len(content) > _LARGE:
            name, content = f"{name}.gz", gzip.compress(content, mtime=0)
        media_type = _MEDIA_TYPES.get(PurePath(name).suffix, "application/octet-stream")
        writer.add_attachment(0, 0, name, media_type, content)
    for topic, time, data in episode:
        writer.add_message(channels[topic], log_time=time, publish_time=time, data=data)
    writer.finish()
