"""A recording that a power failure cut or a disk damaged, as a new and closed file that other tools open."""

import os
from pathlib import Path
from typing import IO, NamedTuple

from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from msp_range.recording.error import RecordingError, new_file
from msp_range.recording.mcap_records import Losses, RawMessage
from msp_range.recording.reader import Recording
from msp_range.recording.writer import LIBRARY


class Recovered(NamedTuple):
    """What `recover` copied, and what was left out of the new file."""

    messages: int
    files: int
    losses: Losses


def recover(path: Path | str, out: Path | str) -> Recovered:
    """Copy everything that is whole in ``path`` into a new and closed MCAP file, which is there only when it is whole.

    Raises
    ------
    RecordingError
        ``path`` is not an MCAP file or nothing in it is whole, or ``out`` is there already or cannot be written.
    """
    recording = Recording(path, salvage=True)
    with new_file(out) as unfinished, unfinished.open("xb") as file:
        messages, files = _copy(recording, file)
        if not (recording.has_magic or messages or files):
            raise RecordingError(f"{path}: not an MCAP recording: it does not begin as one, and holds no messages")
        file.flush()
        os.fsync(file.fileno())
    return Recovered(messages, files, recording.losses)


def _copy(recording: Recording, file: IO[bytes]) -> tuple[int, int]:
    """Write everything that is whole, of whatever encoding; return how many messages and attached files that is."""
    writer = Writer(file, compression=CompressionType.ZSTD)
    writer.start(profile=recording.profile, library=LIBRARY)
    schemas = {0: 0}
    channels: dict[int, int] = {}
    messages = files = 0
    for record in recording.records():
        if isinstance(record, RawMessage):
            if record.channel_id in channels:
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time_ns, record.data, record.publish_time_ns, record.sequence)
                messages += 1
            else:
                recording.losses.messages += 1
        elif isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            # The format numbers channels from 1 to 65535, and has one more number.
            if record.id not in channels and len(channels) < 0xFFFF:
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas.get(record.schema_id, 0), record.metadata
                )
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            files += 1
    writer.finish()
    return messages, files
