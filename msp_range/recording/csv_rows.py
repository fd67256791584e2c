"""The rows of a CSV file that somebody made: text in UTF-8, read piece by piece and within limits.

A path enters, rows of cells leave, each with the number of its line; whatever is no table is refused in a line that
names the place. Compressed files (.gz) are unpacked on the way.
"""

import codecs
import csv
import gzip
import io
import os
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from msp_range.input_file import CONTROL, open_input
from msp_range.recording.error import RecordingError

LARGEST_BYTES = 512 * 2**20
"""A larger file is refused: ten million readings with their contexts fit, and take 60 s and 1 GB to read."""
MOST_EXPANSION = 50
"""Bytes that a compressed file may have unpacked for each of its own. Tables have 5 to 20; a bomb has 1000."""
FREE_EXPANSION_BYTES = 2**20
"""Bytes that the smallest compressed file may have unpacked."""
LONGEST_LINE = 2**18
"""Characters of a line: a row of `MOST_COLUMNS` of the longest cells is shorter."""
MOST_COLUMNS = 1000
"""Columns of a table. Tables of readings have 4 to 40; each column costs 8 bytes of memory for each row."""
LONGEST_CELL = 200
"""Characters of a cell that is kept as a word: names of runs, targets and conditions have 10 to 40."""

_BLOCK = 2**16
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def csv_rows(path: Path, delimiter: str = ",") -> Iterator[tuple[int, list[str]]]:
    """Each row of a table with the number of the line on which it ends; empty lines are left out.

    Raises
    ------
    RecordingError
        The file cannot be read, is too large, not text, or not CSV.
    """
    try:
        with open_input(path, LARGEST_BYTES) as file:
            rows = csv.reader(_lines(path, file), delimiter=delimiter, strict=True)
            for row in rows:
                if len(row) > MOST_COLUMNS:
                    raise RecordingError(
                        f"{path}:{rows.line_num}: found {len(row)} columns, expected at most {MOST_COLUMNS}"
                    )
                if row:
                    yield rows.line_num, row
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise RecordingError(f"{path}: cannot be unpacked: {error}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    except csv.Error as error:
        raise RecordingError(f"{path}:{rows.line_num}: not CSV: {error}") from None


def _lines(path: Path, file: io.BufferedReader) -> Iterator[str]:
    is_packed = path.suffix == ".gz"
    with gzip.GzipFile(fileobj=file) if is_packed else file as stream:
        most = FREE_EXPANSION_BYTES + MOST_EXPANSION * os.fstat(file.fileno()).st_size if is_packed else LARGEST_BYTES
        if stream.peek(2)[:2] in _UTF_16:
            raise RecordingError(f"{path}: found text in UTF-16, expected UTF-8")
        decoder = io.IncrementalNewlineDecoder(codecs.getincrementaldecoder("utf-8-sig")(), translate=True)
        number, read, rest = 1, 0, ""
        while True:
            content = stream.read(_BLOCK)
            try:
                block = decoder.decode(content, final=not content)
            except UnicodeDecodeError as error:
                line = number + error.object.count(b"\n", 0, error.start)
                found = error.object[error.start]
                raise RecordingError(f"{path}:{line}: found the byte 0x{found:02x}, expected text in UTF-8") from None
            read += len(content)
            if read > most:
                raise RecordingError(f"{path}: found more than {most / 1e6:.0f} MB of unpacked text, expected less")
            control = CONTROL.search(block)
            if control is not None:
                line = number + block.count("\n", 0, control.start())
                raise RecordingError(f"{path}:{line}: found the control character {control[0]!r}, expected text")
            rest += block
            end = rest.rfind("\n") + 1
            number += rest.count("\n", 0, end)
            yield from io.StringIO(rest[:end])
            rest = rest[end:]
            if len(rest) > LONGEST_LINE:
                raise RecordingError(f"{path}:{number}: found a line of more than {LONGEST_LINE} characters")
            if not content:
                yield from io.StringIO(rest)
                return


def short_list(names: Sequence[str]) -> str:
    """Names of columns for a message: the first ones, each cut where it is long."""
    shown = [name if len(name) <= 40 else f"{name[:40]}..." for name in names[:20]]
    return ", ".join(shown) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
