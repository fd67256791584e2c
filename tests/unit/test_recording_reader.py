"""Recordings that a power failure cut, that a disk damaged, and files that are none."""

import json
import random
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import SeekingReader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

from msp_range.clock import VirtualClock
from msp_range.recording.error import RecordingError
from msp_range.recording.mcap_records import Losses
from msp_range.recording.reader import Recording
from msp_range.recording.recover import recover
from msp_range.recording.writer import Recorder


def record(path: Path, seconds: int = 6) -> list[dict[str, Any]]:
    """A message every 0.1 s and a chunk every second; returns the messages."""
    recorder = Recorder(path, VirtualClock(), files={"airframe.yaml": "vehicle: quad\n"}, metadata={"vehicle": "quad"})
    messages = []
    for count in range(10 * seconds):
        message = {"time_s": count / 10, "range_m": 1 + count / 7}
        recorder.write("/fused", count / 10, message)
        messages.append(message)
        if count % 10 == 0:
            recorder.flush_if_due(count / 10)
    recorder.close()
    return messages


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """(offset behind a chunk, messages up to there), as the mcap package's index has them."""
    with path.open("rb") as file:
        reader = SeekingReader(file)
        summary = reader.get_summary()
        assert summary is not None
        times_ns = [message.log_time for _, _, message in reader.iter_messages()]
        return [
            (
                index.chunk_start_offset + index.chunk_length,
                sum(time_ns <= index.message_end_time for time_ns in times_ns),
            )
            for index in summary.chunk_indexes
        ]


def read_by_mcap(path: Path) -> list[dict[str, Any]]:
    """Read as other tools do: by the index, checksums verified."""
    with path.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        return [json.loads(message.data) for _, _, message in reader.iter_messages()]


@pytest.mark.slow
def test_a_file_cut_anywhere_gives_every_whole_chunk_and_can_be_recovered(tmp_path: Path) -> None:
    whole = tmp_path / "whole.mcap"
    messages = record(whole)
    data = whole.read_bytes()
    ends = chunk_ends(whole)
    assert len(ends) == 6
    interesting = [end + delta for end, _ in ends for delta in (-1, 0, 1)]
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    for count, size in enumerate(sorted({*range(0, len(data), 11), *interesting, len(data) - 1})):
        cut.write_bytes(data[:size])
        expected = messages[: max((so_far for end, so_far in ends if end <= size), default=0)]
        recording = Recording(cut)
        assert [each.message for each in recording] == expected, size
        assert recording.cut
        assert recording.losses.chunks == 0
        if count % 10 == 0:
            out.unlink(missing_ok=True)
            assert recover(cut, out).messages == len(expected)
            assert read_by_mcap(out) == expected, size
            assert not Recording(out).cut


def test_recovering_keeps_times_attachment_and_metadata(tmp_path: Path) -> None:
    record(tmp_path / "whole.mcap")
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "whole.mcap").read_bytes()[:-1])
    assert recover(tmp_path / "cut.mcap", tmp_path / "out.mcap") == (60, 1, Losses())
    whole, out = Recording(tmp_path / "whole.mcap"), Recording(tmp_path / "out.mcap")
    assert list(out) == list(whole)
    assert out.metadata == whole.metadata
    assert out.metadata["vehicle"] == "quad"
    assert out.files == {"airframe.yaml": "vehicle: quad\n"}
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = SeekingReader(file)
        schemas = [schema for schema, _, _ in reader.iter_messages()]
        assert schemas[0] is not None
        assert schemas[0].name == "msp_range.Fused"
        assert [each.name for each in reader.iter_attachments()] == ["airframe.yaml"]


def test_recovering_never_overwrites(tmp_path: Path) -> None:
    record(tmp_path / "whole.mcap")
    before = (tmp_path / "whole.mcap").read_bytes()
    with pytest.raises(RecordingError, match="there is a file already"):
        recover(tmp_path / "whole.mcap", tmp_path / "whole.mcap")
    assert (tmp_path / "whole.mcap").read_bytes() == before
    with pytest.raises(RecordingError, match=r"out\.mcap: cannot be written: No such file"):
        recover(tmp_path / "whole.mcap", tmp_path / "no folder" / "out.mcap")


@pytest.mark.parametrize("tail", [bytes(5000), random.Random(4).randbytes(5000)], ids=["zeros", "noise"])
def test_what_a_dying_disk_left_behind_the_last_chunk_is_no_data(tmp_path: Path, tail: bytes) -> None:
    messages = record(tmp_path / "whole.mcap")
    end, count = chunk_ends(tmp_path / "whole.mcap")[3]
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "whole.mcap").read_bytes()[:end] + tail)
    recording = Recording(tmp_path / "cut.mcap")
    assert [each.message for each in recording] == messages[:count]
    assert recording.cut
    assert recording.losses == Losses(tail_bytes=5000)


def test_a_chunk_whose_end_never_reached_the_disk_is_no_data(tmp_path: Path) -> None:
    """The file system may know a file's new length before it has the bytes."""
    messages = record(tmp_path / "whole.mcap")
    (_, before), (end, _) = chunk_ends(tmp_path / "whole.mcap")[3:5]
    data = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: end - 40] + bytes(40))
    recording = Recording(tmp_path / "cut.mcap")
    assert [each.message for each in recording] == messages[:before]
    assert recording.losses.chunks == 1


def test_a_damaged_chunk_costs_only_itself(tmp_path: Path) -> None:
    messages = record(tmp_path / "whole.mcap")
    (_, before), (end, after) = chunk_ends(tmp_path / "whole.mcap")[2:4]
    data = bytearray((tmp_path / "whole.mcap").read_bytes())
    data[end - 20] ^= 0x10
    (tmp_path / "damaged.mcap").write_bytes(data)
    recording = Recording(tmp_path / "damaged.mcap")
    expected = messages[:before] + messages[after:]
    assert [each.message for each in recording] == expected
    assert (recording.losses.chunks, recording.cut) == (1, False)
    assert recover(tmp_path / "damaged.mcap", tmp_path / "out.mcap") == (
        len(expected),
        1,
        Losses(chunks=1, seconds=0.9),
    )
    assert read_by_mcap(tmp_path / "out.mcap") == expected


def test_a_damaged_chunk_that_still_unpacks(tmp_path: Path) -> None:
    """Only the checksum finds a digit that has changed in a chunk that is not compressed."""
    writer = Writer(str(tmp_path / "a.mcap"), compression=CompressionType.NONE)
    writer.start()
    channel = writer.register_channel("/fused", "json", 0)
    writer.add_message(channel, 1, b'{"range_m":1.5}', 1)
    writer.finish()
    data = (tmp_path / "a.mcap").read_bytes()
    assert len(list(Recording(tmp_path / "a.mcap"))) == 1
    (tmp_path / "a.mcap").write_bytes(data.replace(b"1.5", b"1.7"))
    recording = Recording(tmp_path / "a.mcap")
    assert list(recording) == []
    assert recording.losses.chunks == 1


def test_a_recording_that_goes_on_is_read_up_to_now(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock(), files={"airframe.yaml": "vehicle: quad\n"})
    recorder.write("/fused", 0.5, {"range_m": 1.0})
    assert list(Recording(tmp_path / "flight.mcap")) == []
    recorder.close()


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_files_of_other_programs(tmp_path: Path, compression: CompressionType, use_chunking: bool) -> None:
    """JSON without our metadata, next to a channel in another encoding; with every compression, and without chunks."""
    path = tmp_path / "other.mcap"
    writer = Writer(str(path), compression=compression, use_chunking=use_chunking, index_types=IndexType.ALL)
    writer.start(profile="ros2", library="other")
    binary = writer.register_channel("/binary", "cdr", 0)
    text = writer.register_channel("/text", "json", 0)
    for count in range(5):
        writer.add_message(binary, count, b"\x00\xff", count)
        writer.add_message(text, 1_500_000_000 + count, b'{"a": %d}' % count, 0, sequence=count)
    writer.finish()
    assert [(each.topic, each.message) for each in Recording(path)] == [("/text", {"a": count}) for count in range(5)]
    assert next(iter(Recording(path))).time_s == 1.5
    assert recover(path, tmp_path / "out.mcap") == (10, 0, Losses())

    def everything(file: Path) -> list[tuple[str, int, int, int, bytes]]:
        topics = {1: "/binary", 2: "/text"}
        with file.open("rb") as stream:
            return [
                (topics[each.channel_id], each.sequence, each.log_time, each.publish_time, each.data)
                for each in StreamReader(stream).records
                if isinstance(each, Message)
            ]

    assert everything(tmp_path / "out.mcap") == everything(path)


def test_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,sensor,reading_cm\n")
    with pytest.raises(RecordingError, match=r"a\.csv: not an MCAP recording: it begins with b'time_s,s'"):
        Recording(tmp_path / "a.csv")
    with pytest.raises(RecordingError, match=r"b\.mcap: cannot be read: No such file or directory"):
        Recording(tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match="cannot be read: found a directory, expected a file"):
        Recording(tmp_path)


def test_a_file_of_no_length_is_a_recording_cut_at_once(tmp_path: Path) -> None:
    (tmp_path / "cut.mcap").write_bytes(b"")
    assert list(Recording(tmp_path / "cut.mcap")) == []
    assert Recording(tmp_path / "cut.mcap").cut
