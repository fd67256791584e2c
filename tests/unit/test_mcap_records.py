"""Recordings with a damaged byte anywhere, and recordings that somebody made to do harm."""

import json
import os
import random
import resource
import struct
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Metadata
from mcap.writer import MCAP0_MAGIC

from msp_range.clock import VirtualClock
from msp_range.config import load_airframe_from
from msp_range.recording.error import RecordingError
from msp_range.recording.export import export
from msp_range.recording.mcap_records import Losses, RawMessage
from msp_range.recording.pings import read_recorded
from msp_range.recording.reader import Recording
from msp_range.recording.recover import recover
from msp_range.recording.writer import Recorder
from msp_range.yaml_file import ConfigError

CHUNKS, PER_CHUNK = 5, 10


def record(path: Path) -> bytes:
    """A chunk a second, with ten readings each; returns the file."""
    recorder = Recorder(path, VirtualClock(), files={"airframe.yaml": "vehicle: quad\n"}, metadata={"vehicle": "quad"})
    for count in range(CHUNKS * PER_CHUNK):
        time_s = count / 10
        recorder.write("/range/left", time_s, reading(time_s, raw=100 + count))
        if count % PER_CHUNK == PER_CHUNK - 1:
            recorder.flush_if_due(time_s + 0.1)
    recorder.close()
    return path.read_bytes()


def reading(time_s: float, **more: Any) -> dict[str, Any]:
    return {"time_s": time_s, "ping_s": time_s, "read_s": time_s + 0.03, "status": "ok", **more}


def packed(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def message(channel: int, data: bytes, log_time_ns: int = 0) -> bytes:
    content = struct.pack("<HIQQ", channel, 0, log_time_ns, 0) + data
    return struct.pack("<BQ", Opcode.MESSAGE, len(content)) + content


def chunk(data: bytes, size: int | None = None) -> bytes:
    uncompressed_size = len(data) if size is None else size
    return packed(Chunk("zstd", zstandard.compress(data), 0, 10**9, zlib.crc32(data), uncompressed_size))


def crafted(path: Path, *records: bytes) -> Path:
    """A file without an end, of these records."""
    path.write_bytes(MCAP0_MAGIC + b"".join(records))
    return path


def ranges(path: Path, *messages: dict[str, Any]) -> Path:
    """A file with these messages of a sensor."""
    return raw_ranges(path, *(json.dumps(each).encode() for each in messages))


def raw_ranges(path: Path, *messages: bytes) -> Path:
    channel = packed(Channel(1, "/range/left", "json", {}, 0))
    return crafted(path, chunk(channel + b"".join(message(1, each) for each in messages)))


@pytest.mark.parametrize("every", [9, pytest.param(1, marks=pytest.mark.slow)])
def test_one_flipped_byte_anywhere_costs_a_chunk_at_most_and_is_reported(every: int, tmp_path: Path) -> None:
    whole = record(tmp_path / "whole.mcap")
    damaged, out = tmp_path / "damaged.mcap", tmp_path / "out.mcap"
    rng = random.Random(1)
    # Bytes in front of the first chunk and behind the last one, and some of those between.
    begin, end = whole.index(b"\x04\0\0\0zstd"), whole.rindex(b"\x04\0\0\0zstd")
    between = rng.sample(range(begin, end), 300 // every)
    for at in [*range(0, begin, every), *between, *range(end, len(whole), every)]:
        data = bytearray(whole)
        data[at] ^= 1 << rng.randrange(8)
        damaged.write_bytes(data)
        out.unlink(missing_ok=True)
        found = recover(damaged, out)
        assert found.messages in (CHUNKS * PER_CHUNK, (CHUNKS - 1) * PER_CHUNK), at
        assert found.files in (0, 1)
        is_less = (found.messages, found.files) != (CHUNKS * PER_CHUNK, 1)
        # What only the end's index had is not lost.
        assert bool(found.losses) or not is_less, at
        assert [each.name for each in tmp_path.iterdir() if each.name.startswith(".")] == []
        with out.open("rb") as file:
            read = SeekingReader(file, validate_crcs=True).iter_messages()
            assert sum(1 for _ in read) == found.messages


def test_kinds_of_damage_are_distinguished(tmp_path: Path) -> None:
    whole = record(tmp_path / "whole.mcap")
    first = whole.index(b"\x04\0\0\0zstd")

    def lost(change: Callable[[bytearray], object]) -> str:
        data = bytearray(whole)
        change(data)
        (tmp_path / "a.mcap").write_bytes(data)
        recording = Recording(tmp_path / "a.mcap")
        list(recording)
        return str(recording.losses)

    def flip(at: int) -> Callable[[bytearray], object]:
        return lambda data: data.__setitem__(at, data[at] ^ 0x10)

    assert lost(lambda data: None) == "nothing"
    assert lost(flip(first + 30)) == "1 damaged chunk (0.9 s)"
    assert lost(flip(whole.index(b"vehicle: quad"))) == "1 damaged or unknown record"
    # The length of the first chunk, and its opcode: the search goes on at the index behind it.
    length = int.from_bytes(whole[first - 36 : first - 28], "little")
    for at in (first - 36, first - 37):
        assert lost(flip(at)) == f"{length + 9} bytes between records"
    assert lost(lambda data: data.__delitem__(slice(first + 40, None))) == "the last 77 bytes, where the file was cut"


def test_without_the_first_chunk_the_end_says_what_the_channels_are(tmp_path: Path) -> None:
    whole = record(tmp_path / "whole.mcap")
    data = bytearray(whole)
    data[whole.index(b"\x04\0\0\0zstd") + 30] ^= 1
    (tmp_path / "a.mcap").write_bytes(data)
    assert len(list(Recording(tmp_path / "a.mcap"))) == (CHUNKS - 1) * PER_CHUNK
    # Cut as well, nobody knows, and each message is counted.
    (tmp_path / "b.mcap").write_bytes(data[: whole.rindex(b"\x04\0\0\0zstd")])
    recording = Recording(tmp_path / "b.mcap")
    assert list(recording) == []
    assert recording.losses.messages == (CHUNKS - 1) * PER_CHUNK


def test_recovering_what_is_no_recording_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello, " * 1000)
    with pytest.raises(RecordingError, match=r"a\.txt: not an MCAP recording"):
        recover(tmp_path / "a.txt", tmp_path / "out.mcap")
    assert os.listdir(tmp_path) == ["a.txt"]
    # What a recovery that was killed left behind does not block the next one.
    (tmp_path / ".out.mcap.new").write_text("half")
    record(tmp_path / "whole.mcap")
    assert recover(tmp_path / "whole.mcap", tmp_path / "out.mcap").messages == CHUNKS * PER_CHUNK


def zeros(size: int) -> bytes:
    """Compressed a megabyte at a time, so that this process's own memory shows what reading them takes."""
    compressor = zstandard.ZstdCompressor().compressobj(size=size)
    return b"".join(compressor.compress(bytes(2**20)) for _ in range(size // 2**20)) + compressor.flush()


BOMBS: dict[str, Callable[[], bytes]] = {
    "claims to be small": lambda: packed(Chunk("zstd", zeros(2**28), 0, 10**9, 0, 100)),
    "says how large it is": lambda: packed(Chunk("zstd", zeros(2**28), 0, 10**9, 0, 2**28)),
    "many of them": lambda: packed(Chunk("zstd", zeros(2**22), 0, 0, 0, 2**22)) * 500,
    "tiny messages": lambda: chunk(packed(Channel(1, "/range/left", "json", {}, 0)) + message(1, b"{}") * 400_000),
    "claims more than there is": lambda: chunk(b"", size=2**60),
    "a length beyond the file": lambda: struct.pack("<BQ", Opcode.CHUNK, 2**63),
    "no content": lambda: struct.pack("<BQ", Opcode.METADATA, 0) * 20_000,
    "looks like records": lambda: b"\x01\x01\x01\x01\x01\0\0\0\0" * 20_000,
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_file_costs_no_more_than_it_is_worth(tmp_path: Path, name: str) -> None:
    content = BOMBS[name]()
    path = crafted(tmp_path / "a.mcap", content)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started_s = time.process_time()
    recording = Recording(path)
    assert list(recording) == []
    assert recording.losses
    assert time.process_time() - started_s < 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 200e3


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"null",
        b"[1]",
        b"\xff",
        b'{"a":' * 5000 + b"1" + b"}" * 5000,
        b'{"time_s":1}',
        json.dumps(reading(1.0, raw="many")).encode(),
        json.dumps(reading(1.0, raw=[1])).encode(),
        json.dumps(reading(1.0, more={})).encode(),
        json.dumps(reading(1e308)).encode(),
        json.dumps(reading(float("nan"))).encode(),
        json.dumps(reading(1.0, rejected="\x1b[31m")).encode(),
        json.dumps(reading(1.0, rejected="x" * 100_000)).encode(),
    ],
)
def test_a_message_that_is_not_of_its_topic_is_left_out_and_counted(tmp_path: Path, text: bytes) -> None:
    good = json.dumps(reading(2.0, raw=200)).encode()
    recording = Recording(raw_ranges(tmp_path / "a.mcap", text, good))
    assert [each.message["time_s"] for each in recording] == [2.0]
    assert recording.losses == Losses(messages=1, tail_bytes=0)
    assert str(recording.losses) == "1 message that cannot be read"
    assert export(recording, tmp_path / "a.csv") == 1


def test_topics_that_a_terminal_would_obey_are_left_out(tmp_path: Path) -> None:
    channel = packed(Channel(1, "/range/\x1b[31m", "json", {}, 0))
    recording = Recording(crafted(tmp_path / "a.mcap", chunk(channel + message(1, json.dumps(reading(1)).encode()))))
    assert list(recording) == []
    assert (recording.losses.records, recording.losses.messages) == (1, 1)


@pytest.mark.parametrize("name", ["/etc/passwd", "../x", "a\x00b", "x" * 300, "", ".", "airframe.yaml/b"])
def test_an_attached_file_is_written_nowhere_else(tmp_path: Path, name: str) -> None:
    airframe = packed(Attachment(0, 0, "airframe.yaml", "", b"vehicle: quad\n"))
    path = crafted(tmp_path / "a.mcap", airframe, packed(Attachment(0, 0, name, "", b"text")))
    with pytest.raises(ConfigError) as raised:
        load_airframe_from(Recording(path).files, path)
    assert str(raised.value).startswith(f"{path}: ")


def test_an_attached_airframe_names_only_files_of_the_recording(tmp_path: Path) -> None:
    folder = Path(__file__).parents[2] / "configs"
    text = (folder / "quad_pallet.yaml").read_text()
    text = text.replace("sensors/mb1242.yaml", str(folder / "sensors/mb1242.yaml"))
    with pytest.raises(ConfigError, match=r"its airframe names /.*mb1242\.yaml, which it does not contain"):
        load_airframe_from({"airframe.yaml": text}, Path("a.mcap"))


@pytest.mark.parametrize(("key", "value"), [("clock_start_s", "nan"), ("clock_start_s", "x"), ("utc_start_ns", "-1")])
def test_times_that_are_none_are_reported_and_can_be_recovered(tmp_path: Path, key: str, value: str) -> None:
    times = {"clock_start_s": "0.0", "utc_start_ns": "0"} | {key: value}
    channel = packed(Channel(1, "/range/left", "json", {}, 0))
    content = chunk(channel + message(1, json.dumps(reading(1.0)).encode()))
    path = crafted(tmp_path / "a.mcap", packed(Metadata("msp_range", times)), content)
    with pytest.raises(RecordingError, match=rf"a\.mcap: metadata msp_range: found .*{key} '{value}'.*expected times"):
        list(Recording(path))
    assert recover(path, tmp_path / "out.mcap").messages == 1


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        ([reading(1.0, raw=100), reading(0.5, raw=100)], "sensor 'left': ping_s goes back from 1.0 to 0.5"),
        ([reading(1.0, raw=70_000)], "sensor 'left' at 1.0 s: raw 70000 is not a number that the sensor's two bytes"),
        ([reading(1.0, raw=-1)], "raw -1 is not a number"),
    ],
)
def test_a_record_that_cannot_be_replayed(tmp_path: Path, messages: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        read_recorded(ranges(tmp_path / "a.mcap", *messages))


def test_a_sensor_was_not_busy_for_years(tmp_path: Path) -> None:
    path = ranges(tmp_path / "a.mcap", reading(1.0, raw=100) | {"read_s": 1e9})
    assert read_recorded(path).pings["left"][0].ready_s == 1.0


def test_messages_without_a_chunk_are_read_and_an_index_is_not_taken_for_one(tmp_path: Path) -> None:
    channel = packed(Channel(1, "/range/left", "json", {}, 0))
    text = json.dumps(reading(1.0)).encode()
    alone = crafted(tmp_path / "a.mcap", channel, message(1, text))
    assert len(list(Recording(alone))) == 1
    mixed = Recording(crafted(tmp_path / "b.mcap", chunk(channel + message(1, text)), message(1, text)))
    assert sum(isinstance(each, RawMessage) for each in mixed.records()) == 1
    assert mixed.losses.records == 1
