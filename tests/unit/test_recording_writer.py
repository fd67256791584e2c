"""The recorder: what is in the file, for every tool; what a failing disk does; nothing of wall time in it."""

import errno
import gc
import io
import itertools
import json
import math
import os
import resource
import struct
import threading
import time
import tracemalloc
import zlib
from collections.abc import Iterator, Sequence
from io import FileIO
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Chunk, ChunkIndex, Footer, MessageIndex, Metadata, SummaryOffset
from mcap.stream_reader import get_chunk_data_stream

from msp_range.clock import VirtualClock
from msp_range.recording import background_file, writer
from msp_range.recording.background_file import BackgroundFile
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_range.recording.topics import TOPICS, schema_of
from msp_range.recording.writer import Recorder
from tests.support.waiting import LIMIT_S, until

START_S = 5000.25
UTC_S = 1_760_000_000.5


class ClockSetInFlight:
    """A bridge's clock that began at START_S, on a computer whose UTC is set back in flight."""

    def __init__(self) -> None:
        self.utc_s = UTC_S

    def now(self) -> float:
        return START_S

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        raise AssertionError("a recorder never sleeps")

    def utc(self) -> float:
        utc_s, self.utc_s = self.utc_s, 0.0
        return utc_s


def record_flight(path: Path, seconds: int = 10) -> list[tuple[str, float, dict[str, Any]]]:
    """A flight of two sensors at 10 readings a second in all; returns what was recorded."""
    clock = VirtualClock()
    recorder = Recorder(path, clock, files={"airframe.yaml": "vehicle: Möwe\n"}, metadata={"vehicle": "Möwe"})
    written = []
    for count in range(10 * seconds):
        time_s = 0.1 * count + 0.03
        clock.sleep_until(time_s)
        sensor = ("left", "right")[count % 2]
        ping_s = time_s - 0.03
        messages: list[tuple[str, float, dict[str, Any]]] = [
            (f"/truth/{sensor}", ping_s, {"true_range_cm": 100.5 + count, "target": "grass"}),
            (
                f"/range/{sensor}",
                time_s,
                {
                    "time_s": ping_s + 0.003,
                    "ping_s": ping_s,
                    "read_s": time_s,
                    "status": "ok",
                    "raw": 100 + count,
                    "range_m": 1.0 + count / 100,
                    "std_m": 0.01,
                    "suspect": False,
                },
            ),
            ("/mavlink/sent", time_s, {"name": "DISTANCE_SENSOR", "hex": f"{count:04x}"}),
        ]
        for topic, message_s, message in messages:
            recorder.write(topic, message_s, message)
            written.append((topic, message_s, message))
        recorder.flush_if_due(time_s)
    recorder.close()
    return written


def test_every_message_comes_back_with_its_topic_and_time(tmp_path: Path) -> None:
    written = record_flight(tmp_path / "flight.mcap")
    recording = Recording(tmp_path / "flight.mcap")
    read = list(recording)
    assert [(each.topic, each.message) for each in read] == [(topic, message) for topic, _, message in written]
    # The file counts whole nanoseconds.
    assert [each.time_s for each in read] == pytest.approx([time_s for _, time_s, _ in written], abs=1e-9)
    assert not recording.cut
    assert str(recording.losses) == "nothing"
    assert recording.files == {"airframe.yaml": "vehicle: Möwe\n"}
    assert recording.metadata["vehicle"] == "Möwe"
    assert list(recording) == read


def test_the_mcap_package_reads_the_file_with_its_index_and_checksums(tmp_path: Path) -> None:
    written = record_flight(tmp_path / "flight.mcap")
    with (tmp_path / "flight.mcap").open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        read = [
            (channel.topic, message.log_time, json.loads(message.data))
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        assert read == [(topic, round(time_s * 1e9), message) for topic, time_s, message in written]
        # By topic it goes through the index of messages.
        assert [message.log_time for _, _, message in reader.iter_messages(topics=["/range/left"])] == [
            round(time_s * 1e9) for topic, time_s, _ in written if topic == "/range/left"
        ]
        summary = reader.get_summary()
        assert summary is not None
        statistics = summary.statistics
        assert statistics is not None
        assert (statistics.message_count, statistics.channel_count) == (300, 5)
        assert sum(statistics.channel_message_counts.values()) == 300
        assert (statistics.message_start_time, statistics.message_end_time) == (0, round(9.93e9))
        # One for each 0.4 s or a little more; the last ones are 0.4 s after each other as near as 0.1 s lets them.
        assert statistics.chunk_count == len(summary.chunk_indexes) == 23
        assert [each.data for each in reader.iter_attachments()] == ["vehicle: Möwe\n".encode()]
        assert [each.metadata["vehicle"] for each in reader.iter_metadata()] == ["Möwe"]


def test_every_index_and_checksum_is_right(tmp_path: Path) -> None:
    """Each offset of the summary is followed to its record, as readers of other languages do."""
    record_flight(tmp_path / "flight.mcap")
    data = (tmp_path / "flight.mcap").read_bytes()

    def record_at(offset: int) -> tuple[int, bytes]:
        opcode, length = struct.unpack_from("<BQ", data, offset)
        return opcode, data[offset + 9 : offset + 9 + length]

    def stream_at(offset: int, opcode: Opcode) -> ReadDataStream:
        assert record_at(offset)[0] == opcode
        return ReadDataStream(io.BytesIO(record_at(offset)[1]))

    footer_offset = len(data) - 8 - 20 - 9
    footer = Footer.read(stream_at(footer_offset, Opcode.FOOTER))
    assert zlib.crc32(data[footer.summary_start : footer_offset + 9 + 16]) == footer.summary_crc
    offset, groups = footer.summary_offset_start, []
    while offset < footer_offset:
        group = SummaryOffset.read(stream_at(offset, Opcode.SUMMARY_OFFSET))
        assert record_at(group.group_start)[0] == group.group_opcode
        groups.append((group.group_start, group.group_length))
        offset += 9 + len(record_at(offset)[1])
    # The groups lie one behind the other, and fill the summary.
    ends = [start + length for start, length in groups]
    assert [start for start, _ in groups] + [footer.summary_offset_start] == [footer.summary_start, *ends]
    with (tmp_path / "flight.mcap").open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None
    for attachment in summary.attachment_indexes:
        kept = Attachment.read(stream_at(attachment.offset, Opcode.ATTACHMENT))
        assert (kept.name, len(kept.data)) == (attachment.name, attachment.data_size)
        assert attachment.length == 9 + len(record_at(attachment.offset)[1])
    for metadata in summary.metadata_indexes:
        assert Metadata.read(stream_at(metadata.offset, Opcode.METADATA)).name == metadata.name
        assert metadata.length == 9 + len(record_at(metadata.offset)[1])
    indexed = 0
    for each in summary.chunk_indexes:
        chunk = Chunk.read(stream_at(each.chunk_start_offset, Opcode.CHUNK))
        assert each.chunk_length == 9 + len(record_at(each.chunk_start_offset)[1])
        content = get_chunk_data_stream(chunk)[0].read(chunk.uncompressed_size)
        assert chunk.uncompressed_crc == zlib.crc32(content)
        assert len(content) == each.uncompressed_size
        assert len(chunk.data) == each.compressed_size
        lengths = 0
        for channel, index_offset in each.message_index_offsets.items():
            index = MessageIndex.read(stream_at(index_offset, Opcode.MESSAGE_INDEX))
            assert index.channel_id == channel
            lengths += 9 + len(record_at(index_offset)[1])
            for time_ns, message_offset in index.records:
                assert struct.unpack_from("<BQHIQ", content, message_offset)[::2] == (Opcode.MESSAGE, channel, time_ns)
                indexed += 1
        assert each.message_index_length == lengths
    assert indexed == 300


def test_identical_virtual_flights_are_identical_files(tmp_path: Path) -> None:
    record_flight(tmp_path / "one.mcap")
    record_flight(tmp_path / "two.mcap")
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()


def test_the_index_of_a_long_file_is_neither_kept_as_objects_nor_copied_at_the_end(tmp_path: Path) -> None:
    """Objects are 1 kB a chunk, 7 MB an hour; a copy 1 MB an hour, which the allocator kept for the writing thread."""
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    for count in range(1, 1001):
        recorder.write("/health", count, {"text": "one"})
        recorder.flush_if_due(count)
    assert sum(type(each) is ChunkIndex for each in gc.get_objects()) < 10  # isinstance asks dead weak references
    tracemalloc.start()
    recorder.close()
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    with (tmp_path / "flight.mcap").open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 1000
    assert most_bytes < 50_000


def test_utc_is_taken_once(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "flight.mcap", ClockSetInFlight())
    recorder.write("/health", START_S, {"text": "one"})
    recorder.flush_if_due(START_S + 1)
    recorder.write("/health", START_S + 2.5, {"text": "two"})
    recorder.close()
    with (tmp_path / "flight.mcap").open("rb") as file:
        times_ns = [message.log_time for _, _, message in SeekingReader(file).iter_messages()]
    assert times_ns == [1_760_000_000_500_000_000, 1_760_000_003_000_000_000]
    assert [each.time_s for each in Recording(tmp_path / "flight.mcap")] == [START_S, START_S + 2.5]


def test_what_is_unknown_is_left_out(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    recorder.write("/fused", 1.0, {"time_s": 1.0, "range_m": None, "variance_m2": math.inf})
    times = {"time_s": 2.0, "ping_s": 2.0, "read_s": 2.1}
    recorder.write("/range/left", 2.0, {**times, "status": "ok", "raw": None, "range_m": math.nan})
    recorder.close()
    assert [each.message for each in Recording(tmp_path / "flight.mcap")] == [
        {"time_s": 1.0},
        {**times, "status": "ok"},
    ]


_SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats() | st.text()


@settings(max_examples=50)
@given(messages=st.lists(st.dictionaries(st.text(), _SCALARS), max_size=5))
def test_any_json_comes_back(tmp_path: Path, messages: list[dict[str, Any]]) -> None:
    path = tmp_path / "flight.mcap"
    path.unlink(missing_ok=True)
    recorder = Recorder(path, VirtualClock())
    for message in messages:
        recorder.write("/health", 1.0, message)
    recorder.close()

    def known(message: dict[str, Any]) -> dict[str, Any]:
        unknown = (None, math.inf, -math.inf)
        return {key: each for key, each in message.items() if each not in unknown and each == each}

    assert [known(each.message) for each in Recording(path)] == [known(message) for message in messages]


def test_an_unknown_topic_or_value_is_refused_and_leaves_the_file_whole(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    recorder.write("/health", 1.0, {"text": "one"})
    with pytest.raises(ValueError, match=r"no topic '/ragne/left'; known: .*/range/<sensor>"):
        recorder.write("/ragne/left", 1.0, {})
    with pytest.raises(TypeError, match="bytes"):
        recorder.write("/mavlink/sent", 1.0, {"hex": b"\xfd"})
    recorder.write("/health", 2.0, {"text": "two"})
    recorder.close()
    assert [each.message["text"] for each in Recording(tmp_path / "flight.mcap")] == ["one", "two"]


@pytest.mark.parametrize("topic", [*TOPICS, "/truth/left", "/range/left", "/truth/reading"])
def test_schemas_are_such_that_foxglove_takes_them(topic: str) -> None:
    """Foxglove and Lichtblick want an object with properties, each of one type that is not null."""
    _, text = schema_of(topic)
    schema = json.loads(text)
    assert schema["type"] == "object"
    assert schema["properties"]
    for each in schema["properties"].values():
        assert each["type"] in {"boolean", "string", "number", "integer", "object"}
        assert each["description"]
        assert "properties" in each or each["type"] != "object"


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "flight.mcap").write_bytes(b"an older flight")
    with pytest.raises(RecordingError, match="there is a file already"):
        Recorder(tmp_path / "flight.mcap", VirtualClock())
    assert (tmp_path / "flight.mcap").read_bytes() == b"an older flight"
    with pytest.raises(RecordingError, match="No such file or directory"):
        Recorder(tmp_path / "no folder" / "flight.mcap", VirtualClock())


@pytest.fixture
def small_disk() -> Iterator[int]:
    """A limit of 20000 bytes a file, which the kernel enforces as it does the end of a disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    yield 20_000
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def noisy(time_s: float) -> dict[str, Any]:
    """A message that does not compress: the digits of a chaotic map."""
    return {"text": "".join(str(math.sin(time_s * factor))[3:] for factor in range(1, 40))}


def test_on_a_full_disk_what_was_written_is_there(tmp_path: Path, small_disk: int) -> None:
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    faults = []
    for second in range(1, 200):
        for count in range(3):
            recorder.write("/health", second + count / 3, noisy(second + count / 3))
        recorder.flush_if_due(second + 1)
        faults.append(recorder.fault)
    with pytest.raises(
        RecordingError, match=r"flight.mcap: recording stopped: File too large; the first \d+ bytes are"
    ):
        recorder.close()
    assert set(faults) <= {None, f"disk error (errno {errno.EFBIG})"}
    recording = Recording(tmp_path / "flight.mcap")
    texts = [each.message for each in recording]
    assert recording.cut
    assert texts == [noisy(second + count / 3) for second in range(1, 200) for count in range(3)][: len(texts)]
    assert len(texts) > small_disk / 2 / len(noisy(1.0)["text"])


class StoppedDisk:
    """An os.fdatasync that does not come back until the test lets it."""

    def __init__(self) -> None:
        self.entered = threading.Event()
        self.go_on = threading.Event()

    def fdatasync(self, descriptor: int) -> None:
        self.entered.set()
        assert self.go_on.wait(LIMIT_S)


@pytest.fixture
def stopped_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[StoppedDisk]:
    disk = StoppedDisk()
    monkeypatch.setattr(os, "fdatasync", disk.fdatasync)
    yield disk
    disk.go_on.set()


def recording_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "recording"]


def test_a_full_disk_is_a_fault_and_no_exception(tmp_path: Path, small_disk: int) -> None:
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    for count in range(100):
        recorder.write("/health", count / 100, noisy(count))
    # One block, and larger than the disk.
    recorder.flush_if_due(1.0)
    for thread in recording_threads():
        thread.join(LIMIT_S)
    assert recorder.fault is None
    recorder.flush_if_due(2.0)
    assert recorder.fault == f"disk error (errno {errno.EFBIG})"
    recorder.write("/health", 3.0, {"text": "not recorded"})
    recorder.flush_if_due(4.0)
    with pytest.raises(RecordingError, match="nothing is kept"):
        recorder.close()
    # Nothing of it was kept, and an empty file would only be in the way.
    assert not (tmp_path / "flight.mcap").exists()


def test_a_slow_disk_does_not_hold_up_the_bridge(tmp_path: Path, stopped_disk: StoppedDisk) -> None:
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    assert stopped_disk.entered.wait(LIMIT_S)
    for second in range(1, 100):
        recorder.write("/health", second, {"text": "on time"})
        recorder.flush_if_due(second)
    assert not stopped_disk.go_on.is_set()
    assert recorder.fault is None
    stopped_disk.go_on.set()
    recorder.close()
    assert len(list(Recording(tmp_path / "flight.mcap"))) == 99
    assert not recording_threads()


@pytest.fixture
def real(monkeypatch: pytest.MonkeyPatch) -> VirtualClock:
    """What counts as real time of the disk: it stands still unless a test or the recorder moves it."""
    clock = VirtualClock()
    monkeypatch.setattr(background_file, "SystemClock", lambda: clock)
    return clock


def test_simulated_time_waits_for_a_slow_disk(tmp_path: Path, stopped_disk: StoppedDisk, real: VirtualClock) -> None:
    file = BackgroundFile(lambda: FileIO(tmp_path / "flight.mcap", "x"))
    recorder = Recorder(file, VirtualClock(), waits=True)
    assert stopped_disk.entered.wait(LIMIT_S)
    recorder.write("/health", 1.0, {"text": "waits"})
    recorder.flush_if_due(1.0)
    assert real.now() == 0.0
    real.sleep_until(1.5)
    recorder.flush_if_due(2.0)
    assert real.now() == pytest.approx(10.0, abs=0.2)
    assert recorder.fault == "disk does not answer"
    stopped_disk.go_on.set()
    file.join(LIMIT_S)


def test_a_disk_that_hangs_is_a_fault_after_ten_seconds_of_real_time(
    tmp_path: Path, stopped_disk: StoppedDisk, real: VirtualClock
) -> None:
    """However little is waiting: at 3 kB a second a limit of bytes would be reached after hours."""
    file = BackgroundFile(lambda: FileIO(tmp_path / "flight.mcap", "x"))
    recorder = Recorder(file, VirtualClock())
    assert stopped_disk.entered.wait(LIMIT_S)
    faults = []
    for second in range(1, 20):
        real.sleep_until(second)
        recorder.write("/health", second, {"text": "waits"})
        recorder.flush_if_due(second)
        faults.append(recorder.fault)
    assert faults == [None] * 10 + ["disk does not answer"] * 9
    # What was recorded until then is written when the disk comes back.
    stopped_disk.go_on.set()
    file.join(LIMIT_S)
    recording = Recording(tmp_path / "flight.mcap")
    assert [each.time_s for each in recording] == list(range(1, 12))
    assert not recording.cut


def test_closing_does_not_wait_for_ever(
    tmp_path: Path, stopped_disk: StoppedDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "CLOSE_TIMEOUT_S", 0.05)
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    recorder.write("/health", 1.0, {"text": "lost"})
    with pytest.raises(RecordingError, match="the disk does not answer"):
        recorder.close()


def test_a_file_that_was_moved_away_is_a_fault(tmp_path: Path) -> None:
    """Writing to it raises nothing."""
    folder = tmp_path / "flights"
    folder.mkdir()
    recorder = Recorder(folder / "flight.mcap", VirtualClock())
    folder.rename(tmp_path / "other")
    seconds = itertools.count(1)

    def record() -> None:
        second = next(seconds)
        recorder.write("/health", second, {"text": "where to?"})
        recorder.flush_if_due(second)
        time.sleep(0.01)

    until(lambda: recorder.fault == "folder gone", work=record, seen=lambda: recorder.fault)
    with pytest.raises(RecordingError, match="No such file or directory"):
        recorder.close()
