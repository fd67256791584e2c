"""Messages of an ArduPilot dataflash log (.BIN) as columns, piece by piece.

pymavlink indexes the messages and knows their formats; numpy takes the values of all messages of a type at once, where
pymavlink itself makes an object of each. A log of a gigabyte is read in pieces, each behind the format messages of
those before it, so memory does not grow with the file.
"""

import contextlib
import os
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import dfindexer
from pymavlink.DFReader import FORMAT_TO_STRUCT, DFFormat

from msp_range.arrays import Column
from msp_range.input_file import open_input
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import LARGEST_FILE_BYTES

Progress = Callable[[float], None]
Messages = Mapping[str, Mapping[str, Column]]
"""Message -> field -> values, numbers as float64 in the unit of the log's format, texts as bytes."""

MAGIC = b"\xa3\x95"
PIECE_BYTES = 8 * 2**20
"""The log is read in pieces of this size: the index of one takes some 10 MB. Larger ones are not faster."""
MOST_BAD_BYTES = PIECE_BYTES // 8
"""After a piece with more bytes outside of messages nothing more is read: the log was cut there, or is none. One with a
few lost sectors has thousands; a larger number reads on through what has hardly any message."""
_FMT, _FMT_BYTES = 0x80, 89
"""The format message has this type and length in every log; its own type, length, name, format and field names follow
after 3 bytes of header (AP_Logger, LogStructure.h)."""
PLACE = "place"
"""Asked for like a field: where in the file each message is. No field of a log has a name in small letters only."""
TEXTS = ("Name", "Message")
"""Fields that are texts, of all that are read; the others are numbers."""
_FIELD = re.compile(r"\d*[a-zA-Z]")


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Nothing on standard error: pymavlink's indexer, which is compiled, prints a line for each byte of no message."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def read_messages(path: Path, wanted: Mapping[str, Sequence[str]], progress: Progress) -> tuple[Messages, str]:
    """Some messages of a log, and what was lost.

    Parameters
    ----------
    path
        The file.
    wanted
        Message -> fields; those that the log does not have are left out.
    progress
        Called with the share of the file that is read.

    Raises
    ------
    RecordingError
        It cannot be read, is no dataflash log, or is damaged throughout.
    """
    if not dfindexer.available:
        raise RecordingError(f"{path}: this pymavlink has no indexer for dataflash logs; install one from a wheel")
    found: dict[str, dict[str, list[Column]]] = {}
    formats, rest, bad = b"", b"", 0
    try:
        with open_input(path, LARGEST_FILE_BYTES) as file:
            size = file.seek(0, 2)
            if not size:
                raise RecordingError(f"{path}: no dataflash log: the file is empty")
            file.seek(0)
            while new := file.read(PIECE_BYTES):
                begins, piece = len(formats), formats + rest + new
                offsets = _index(path, piece)
                if not offsets[_FMT]:
                    raise RecordingError(f"{path}: no dataflash log: it begins with {piece[:8]!r}")
                # The last message may go on in the next piece, and is read with that one.
                end, in_messages = begins, 0
                for kind, form in _formats(piece, offsets[_FMT]).items():
                    first, last = bisect_left(offsets[kind], begins), bisect_right(offsets[kind], len(piece) - form.len)
                    places = offsets[kind][first:last]
                    if places:
                        end = max(end, places[-1] + form.len)
                        in_messages += len(places) * form.len
                        if form.name in wanted:
                            _add_values(found, piece, places, form, wanted[form.name])
                        if PLACE in wanted.get(form.name, ()):
                            at = np.array(places) + (file.tell() - len(piece))
                            found.setdefault(form.name, {}).setdefault(PLACE, []).append(at)
                bad += end - begins - in_messages
                rest = piece[end:]
                if len(piece) - begins - in_messages > MOST_BAD_BYTES:
                    if not formats:
                        raise RecordingError(f"{path}: no dataflash log, or damaged at its beginning")
                    bad += size - file.tell()
                    break
                newest = {piece[at + 3]: piece[at : at + _FMT_BYTES] for at in offsets[_FMT]}
                formats = b"".join(each for each in newest.values() if len(each) == _FMT_BYTES)
                progress(file.tell() / size)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    joined = {name: {field: np.concatenate(parts) for field, parts in fields.items()} for name, fields in found.items()}
    bad += len(rest)
    return joined, f"{bad} bytes that belong to no message are left out" if bad else ""


def _index(path: Path, piece: bytes) -> list[list[int]]:
    """Places of the messages of each type in a piece that begins with the log's formats."""
    if len(piece) < _FMT_BYTES or MAGIC not in piece:
        raise RecordingError(f"{path}: no dataflash log: it begins with {piece[:8]!r}")
    with _silent():
        found: list[list[int]] = dfindexer.build_offsets(
            memoryview(piece), _FMT, _FMT_BYTES, 3, 4, *MAGIC, progress_callback=None
        )
    return found


def _formats(piece: bytes, places: Sequence[int]) -> dict[int, Any]:
    """Formats by the type of their messages, the last one of each."""
    found = {}
    for at in {piece[at + 3]: at for at in places if at + _FMT_BYTES <= len(piece)}.values():
        kind, length = piece[at + 3], piece[at + 4]
        name, form, fields = (
            piece[at + a : at + b].split(b"\0")[0].decode("ascii", "replace") for a, b in ((5, 9), (9, 25), (25, 89))
        )
        if not set(form) <= FORMAT_TO_STRUCT.keys():
            continue
        made = DFFormat(kind, name, length, form, fields)
        if 3 + _layout(made).itemsize <= length and len(made.columns) == len(made.msg_mults):
            found[kind] = made
    return found


def _layout(form: Any) -> np.dtype[Any]:
    """A message's fields as numpy has them; pymavlink writes them in the letters of `struct`, which are numpy's."""
    letters = _FIELD.findall(form.msg_struct[1:])
    types = [f"S{each[:-1]}" if each.endswith("s") else f"<{each}" for each in letters]
    return np.dtype([(f"f{index}", each) for index, each in enumerate(types)])


def _add_values(
    found: dict[str, dict[str, list[Column]]],
    piece: bytes,
    places: Sequence[int],
    form: Any,
    fields: Sequence[str],
) -> None:
    """Add the values of all messages of one type in a piece."""
    layout = _layout(form)
    at = np.array(places, dtype=np.int64)
    content = np.frombuffer(piece, dtype=np.uint8)
    rows = content[at[:, None] + np.arange(3, 3 + layout.itemsize)].view(layout).reshape(-1)
    for index, name in enumerate(form.columns):
        if name in fields:
            values = rows[f"f{index}"]
            if (values.dtype.kind == "S") != (name in TEXTS):
                continue  # the letter of its format is damaged
            if name not in TEXTS:
                with np.errstate(invalid="ignore"):  # bytes that are not a number
                    values = values.astype(float) * (form.msg_mults[index] or 1.0)
            found.setdefault(form.name, {}).setdefault(name, []).append(values)
