"""A recording that a power failure cut, closed again so that other tools open it."""

import os
from pathlib import Path
from typing import IO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from msp_range.recording.error import RecordingError
from msp_range.recording.reader import MESSAGE_HEAD, Recording, as_stream
from msp_range.recording.writer import LIBRARY


class Recovered(NamedTuple):
    """What `recover` found: messages copied, and chunks left out because their checksum was wrong."""

    messages: int
    damaged_chunks: int


def recover(path: Path | str, out: Path | str) -> Recovered:
    """Copy everything that is whole in ``path`` into a new and closed MCAP file.

    Raises
    ------
    RecordingError
        ``path`` is not an MCAP file, or ``out`` is there already or cannot be written.
    """
    recording = Recording(path)
    try:
        with Path(out).open("xb") as file:
            messages = _copy(recording, file)
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        raise RecordingError(f"{out}: there is a file already, and recovering never overwrites one") from None
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written: {error.strerror}") from None
    return Recovered(messages, recording.damaged_chunks)


def _copy(recording: Recording, file: IO[bytes]) -> int:
    """Write everything that is whole, of whatever encoding; return how many messages that is."""
    writer = Writer(file, compression=CompressionType.ZSTD)
    writer.start(profile=recording.profile, library=LIBRARY)
    schemas = {0: 0}
    channels: dict[int, int] = {}
    messages = 0
    for opcode, content in recording.records():
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(content)
            if channel_id in channels:
                data = content[MESSAGE_HEAD.size :]
                writer.add_message(channels[channel_id], log_time_ns, data, publish_time_ns, sequence)
                messages += 1
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(as_stream(content))
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(as_stream(content))
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
                )
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(as_stream(content))
            writer.add_metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.ATTACHMENT:
            kept = Attachment.read(as_stream(content))
            writer.add_attachment(kept.create_time, kept.log_time, kept.name, kept.media_type, kept.data)
    writer.finish()
    return messages
