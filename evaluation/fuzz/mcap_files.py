"""MCAP: recordings of a simulated flight and of a bench, changed in their bytes, records, chunks and messages."""

import contextlib
import io
import json
import os
import struct
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import lz4.frame
import yaml
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from evaluation.fuzz import base, mutate, played
from msp_range.clock import VirtualClock
from msp_range.config import load_airframe, load_airframe_from
from msp_range.input_file import CONTROL
from msp_range.recording.csv_form import read_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.export import export
from msp_range.recording.mcap_records import RawMessage
from msp_range.recording.pings import read_recorded
from msp_range.recording.reader import Recording
from msp_range.recording.recover import recover
from msp_range.recording.writer import Recorder
from msp_range.tuning import recorded_tracks
from msp_range.yaml_file import ConfigError
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import load_scenario
from tests.support.campaigns import Collected, campaign

CONFIGS = Path("configs").absolute()
LONGEST_MESSAGE = 25_000
_HEAD = struct.Struct("<BQ")
_CHUNK, _MESSAGE = 0x06, 0x05
_OPCODES = (*range(17), 0x7F, 0x80, 0xFF)


def fuzz(seconds: float, seed: int) -> base.FuzzResult:
    """Read changed recordings for so long [s]."""
    with tempfile.TemporaryDirectory() as folder:
        whole = [path.read_bytes() for path in _recordings(Path(folder))]
    return base.run("mcap", seconds, seed, lambda rng: _case(whole, rng), prepare)


def _recordings(folder: Path) -> Iterator[Path]:
    """Whole recordings: a flight as it is recorded, the same in other forms, and a session at a bench."""
    flown = folder / "flight.mcap"
    scenario = folder / "scenario.yaml"
    altitude = [{"kind": "ramp", "to_m": 1.0, "duration_s": 1.5}]
    content = {"name": "short", "airframe": str(CONFIGS / "quad_pallet.yaml"), "duration_s": 1.6}
    scenario.write_text(yaml.safe_dump(content | {"flight": {"altitude": altitude}}))
    loaded, clock = load_scenario(scenario), VirtualClock()
    # The models under the names that a recording can hold.
    files = {name.split("/")[-1]: text for name, text in loaded.airframe.files.items()}
    files["airframe.yaml"] = files["airframe.yaml"].replace("sensors/", "")
    recorder = Recorder(flown, clock, files=files, metadata={"scenario": "short"})
    for _ in Simulation(loaded, clock, 1, recorder=recorder).fly():
        pass
    recorder.close()
    yield flown
    for number, (compression, is_chunked) in enumerate(
        ((CompressionType.NONE, True), (CompressionType.LZ4, True), (CompressionType.ZSTD, False))
    ):
        yield _rewritten(flown, folder / f"{number}.mcap", compression, is_chunked)
    collected = Collected(campaign(folder, readings=5), folder / "bench")
    collected.go()
    yield from (folder / "bench").glob("*.mcap")


def _rewritten(path: Path, out: Path, compression: CompressionType, is_chunked: bool) -> Path:
    writer = Writer(str(out), chunk_size=2000, compression=compression, use_chunking=is_chunked)
    writer.start()
    schemas, channels = {0: 0}, {}
    for record in Recording(path).records():
        if isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels:
            schema = schemas[record.schema_id]
            channels[record.id] = writer.register_channel(record.topic, record.message_encoding, schema)
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(0, 0, record.name, record.media_type, record.data)
        elif isinstance(record, RawMessage):
            writer.add_message(channels[record.channel_id], record.log_time_ns, record.data, record.publish_time_ns)
    writer.finish()
    return out


def prepare(folder: Path) -> base.Check:
    """The check: recover, export, replay or tune, as a case's content decides; only errors of the project may come."""
    path, out, table = folder / "fuzzed.mcap", folder / "out.mcap", folder / "out.csv"
    airframe = load_airframe("configs/quad_pallet.yaml")

    def recovered() -> None:
        out.unlink(missing_ok=True)
        try:
            found = recover(path, out)
        except RecordingError:
            assert sorted(os.listdir(folder)) == sorted({"fuzzed.mcap", *(["out.csv"] if table.exists() else [])})
            raise
        with out.open("rb") as file:
            read = sum(1 for _ in SeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False))
        assert read == found.messages
        again = Recording(out)
        assert sum(isinstance(each, RawMessage) for each in again.records()) == read
        assert not again.losses
        assert not again.cut

    def exported() -> None:
        table.unlink(missing_ok=True)
        rows = export(path, table)
        assert len(read_csv(table)) == rows

    def replayed() -> None:
        recording = Recording(path)
        recorded = read_recorded(recording)
        try:
            flown = load_airframe_from(recording.files, path)
        except ConfigError as error:
            _check_message(str(error), path)
            flown = airframe
        played.play(flown, recorded, path)

    def check(data: bytes) -> None:
        path.write_bytes(data)
        commands = (recovered, recovered, exported, replayed, lambda: recorded_tracks(path))
        try:
            commands[zlib.crc32(data) % len(commands)]()
        except (RecordingError, ConfigError) as error:
            _check_message(str(error), path)

    with tempfile.TemporaryDirectory() as other:
        for whole in _recordings(Path(other)):
            path.write_bytes(whole.read_bytes())
            recovered()
            exported()
            with contextlib.suppress(RecordingError):  # a bench has no airframe
                replayed()
    return check


def _check_message(text: str, path: Path) -> None:
    assert str(path.parent) in text, f"no file is named: {text[:500]}"
    assert len(text) <= LONGEST_MESSAGE, f"a message of {len(text)} characters"
    # Commands print what is not printable as its escape sequence.
    assert CONTROL.search(text) is None or repr(text), text


def _case(whole: list[bytes], rng: Random) -> bytes:
    data = rng.choice(whole)
    how = rng.randrange(10)
    if how < 3:
        return mutate.of_bytes(data, rng)
    if how < 6:
        return _in_records(data, rng, _changed)
    if how < 9:
        return _in_records(data, rng, lambda opcode, content, rng: _in_chunk(content, rng))
    return _crafted(data, rng)


def _records(data: bytes, position: int) -> Iterator[tuple[int, bytes]]:
    while position + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        position += _HEAD.size
        yield opcode, data[position : position + length]
        position += length


def _joined(records: list[tuple[int, bytes]]) -> bytes:
    return b"".join(_HEAD.pack(opcode, len(content)) + content for opcode, content in records)


def _in_records(data: bytes, rng: Random, change: Any) -> bytes:
    """Some records outside of chunks changed, or the chunks' content."""
    records = list(_records(data[: -len(MCAP0_MAGIC)], len(MCAP0_MAGIC)))
    for _ in range(rng.choice((1, 1, 2, 5))):
        chunks = [index for index, (opcode, _) in enumerate(records) if opcode == _CHUNK]
        at = rng.choice(chunks) if chunks and change is not _changed else rng.randrange(len(records))
        opcode, content = records[at]
        if change is not _changed and opcode != _CHUNK:
            records[at : at + 1] = list(_records(_in_messages(_joined([records[at]]), rng), 0))
        else:
            records[at : at + 1] = list(_records(change(opcode, content, rng), 0)) or records[at : at + 1]
    if rng.random() < 0.1:
        rng.shuffle(records)
    return MCAP0_MAGIC + _joined(records) + rng.choice((MCAP0_MAGIC, MCAP0_MAGIC, b""))


def _changed(opcode: int, content: bytes, rng: Random) -> bytes:
    """A record with another opcode, length or content, several times, or not at all."""
    how = rng.randrange(6)
    if how == 0:
        return _HEAD.pack(rng.choice(_OPCODES), len(content)) + content
    if how == 1:
        return _HEAD.pack(opcode, _size(rng)) + content
    if how == 2:
        return (_HEAD.pack(opcode, len(content)) + content) * rng.choice((0, 2, 50))
    if how == 3 and len(content) >= 8:
        # A length inside of it, wherever it is.
        at = rng.randrange(len(content) - 3)
        width = rng.choice((4, 8))
        changed = content[:at] + _size(rng).to_bytes(8, "little")[:width] + content[at + width :]
        return _HEAD.pack(opcode, len(changed)) + changed
    if how == 4:
        return _one(rng)
    changed = mutate.of_bytes(content, rng)
    return _HEAD.pack(opcode, len(changed)) + changed


def _size(rng: Random) -> int:
    return rng.choice((0, 1, 8, 255, 65535, 2**20, 2**31, 2**32 - 1, 2**40, 2**63, 2**64 - 1, rng.randrange(5000)))


def _one(rng: Random) -> bytes:
    """A well-formed record with odd content."""
    word = mutate.pick(rng, mutate.WORDS, mutate.NUMBERS, ("airframe.yaml", "/range/front_left", "mb1242.yaml"))
    text = word.encode("utf-8", "surrogatepass")
    times = {"clock_start_s": rng.choice(mutate.NUMBERS), "utc_start_ns": rng.choice(mutate.NUMBERS)}
    stream = RecordBuilder()
    rng.choice(
        (
            Header(word, word),
            Metadata("msp_range", times),
            Metadata(word, {word: word, "": ""}),
            Attachment(0, 2**64 - 1, word, word, text * rng.choice((1, 1000))),
            Attachment(0, 0, "airframe.yaml", "", rng.choice((b"", b"[" * 10_000, b"vehicle: x\n", b"\xff", text))),
            Channel(rng.choice((0, 1, 2, 65535)), rng.choice((word, "/range/" + word)), "json", {word: word}, 65535),
            Schema(rng.choice((0, 1, 65535)), text, word, word),
            Footer(rng.choice((0, 8, 2**63)), 2**64 - 1, 0),
        )
    ).write(stream)
    return bytes(stream.end())


def _in_chunk(content: bytes, rng: Random) -> bytes:
    """A chunk whose records are changed, whole again on the outside, mostly."""
    try:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(content)))
        data = {"zstd": zstandard.decompress, "lz4": lz4.frame.decompress, "": bytes}[chunk.compression](chunk.data)
    except Exception:  # it was changed before
        return b""
    return _chunk(_in_messages(data, rng), rng)


def _chunk(data: bytes, rng: Random, size: int | None = None) -> bytes:
    compression = rng.choice(("zstd", "zstd", "lz4", "", "zip"))
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)(data)
    checksum = zlib.crc32(data) if rng.random() < 0.9 else rng.choice((0, 1))
    size = len(data) if size is None and rng.random() < 0.9 else size or _size(rng)
    builder = RecordBuilder()
    Chunk(compression, packed, rng.choice((0, 5, 2**64 - 1)), 5, checksum, size).write(builder)
    return bytes(builder.end())


def _in_messages(data: bytes, rng: Random) -> bytes:
    records = list(_records(data, 0))
    for _ in range(rng.choice((1, 1, 3, 10))):
        if not records:
            break
        at = rng.randrange(len(records))
        opcode, content = records[at]
        if opcode == _MESSAGE and len(content) > 22 and rng.random() < 0.8:
            records[at] = (opcode, _in_message(content, rng))
        else:
            records[at : at + 1] = list(_records(_changed(opcode, content, rng), 0))
    joined = _joined(records)
    return joined + rng.choice((b"", b"", b"", bytes(5), b"\x05", _HEAD.pack(5, 2**63)))


def _in_message(content: bytes, rng: Random) -> bytes:
    """A message with other times, another channel, or other JSON."""
    channel, sequence, log_ns, publish_ns = struct.unpack_from("<HIQQ", content)
    text = content[22:]
    how = rng.randrange(6)
    if how == 0:
        log_ns = rng.choice((0, 1, 2**63, 2**64 - 1, (log_ns + 10**9) % 2**64))
    elif how == 1:
        channel = rng.choice((0, 1, 2, 65535))
    elif how == 2:
        text = rng.choice((b"", b"null", b"[]", b"1", b'"a"', b"NaN", b"{", b'{"a":1e999}', b"\xff", b"{}" * 100))
    elif how == 3:
        text = rng.choice((b'{"a":' * 2000 + b"1" + b"}" * 2000, b"[" * 100_000, b'{"' + b"k" * 100_000 + b'":1}'))
    else:
        try:
            message = json.loads(text)
            key = rng.choice([*message, "more"])
            message[key] = _json_value(rng)
            text = json.dumps(message).encode()
        except (ValueError, TypeError, RecursionError):
            text = mutate.of_bytes(text, rng)
    return struct.pack("<HIQQ", channel, sequence, log_ns, publish_ns) + text


def _json_value(rng: Random) -> Any:
    others: tuple[Any, ...] = (None, True, [], {}, [1, 2], {"a": {"b": 1}}, "no_echo", "ok", "clock_fault")
    numbers = (0, -1, 1e308, -1e308, 1e12, 1e10, 1e-9, 2**63, 2**64, 10**30, 65536, -5, 765, 255, 0.5, float("nan"))
    words = mutate.pick(rng, mutate.WORDS, mutate.NUMBERS)
    return rng.choice((rng.choice(numbers), rng.choice(numbers), rng.choice(others), words))


def _crafted(data: bytes, rng: Random) -> bytes:
    """What is made to cost much: bombs, endless records, many channels, what looks like records everywhere."""
    count = rng.choice((1, 100, 10_000))
    bomb = _chunk(bytes(rng.choice((10**6, 10**7))), rng)
    header = data[: data.index(b"\x06", 9)] if b"\x06" in data[9:] else data[:50]
    channels = b"".join(_channel(number, f"/range/s{number}") for number in range(min(count, 70_000)))
    names = b"".join(
        _message(1, json.dumps({"true_range_cm": 1, f"k{number}": number}).encode()) for number in range(count)
    )
    tiny = _HEAD.pack(0x07, 6) + bytes(6)
    end = data[-400:]
    return rng.choice(
        (
            header + bomb * (rng.choice((1, 20, 300)) if len(bomb) < 10**5 else 1) + end,
            header + _chunk(bytes(1000), rng, size=2**40) + end,
            header + _chunk(channels, rng) + end,
            header + _chunk(_channel(1, "/truth/front_left") + names, rng) + end,
            header + _chunk(_channel(1, "/range/front_left") + _reading(0.0) * count, rng) + end,
            header + _chunk(_channel(1, "/range/front_left") + _reading(-1e9) + _reading(1e9), rng) + end,
            header + _HEAD.pack(0x09, 2**62) + end,
            header + b"\x01\x01\x01\x01\x01\0\0\0\0" * count + end,
            header + tiny * count + end,
            header + _one(rng) * count + end,
            MCAP0_MAGIC + bytes(count * 100),
            MCAP0_MAGIC + rng.randbytes(count * 10),
            MCAP0_MAGIC[:4],
            rng.randbytes(8) + data[8:],
            data + data,
            data[: rng.randrange(len(data))],
            b"",
        )
    )


def _channel(number: int, topic: str) -> bytes:
    builder = RecordBuilder()
    Channel(number & 0xFFFF, topic, "json", {}, 0).write(builder)
    return bytes(builder.end())


def _message(channel: int, text: bytes) -> bytes:
    content = struct.pack("<HIQQ", channel, 0, 0, 0) + text
    return _HEAD.pack(_MESSAGE, len(content)) + content


def _reading(time_s: float) -> bytes:
    times = {"time_s": time_s, "ping_s": time_s, "read_s": time_s + 0.05}
    return _message(1, json.dumps({**times, "status": "ok", "raw": 200}).encode())
