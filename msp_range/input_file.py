"""Files that a user names, opened so that nothing which stands under the name can do harm.

A path and a size limit enter, an open file or its text leaves. What is no regular file (a directory, a pipe on which an
open would wait, a device without an end) and what is too large is refused with an OSError whose ``strerror`` says what
was found and what was expected, so that callers report it as they report a missing file.
"""

import codecs
import errno
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\u202a-\u202e\u2066-\u2069]")
"""Characters that are no text: control characters but tab and line feed (a terminal obeys them, the escape character
above all), halves of surrogate pairs (no encoding has them), and those that turn the direction of writing."""


def open_input(path: Path | str, most_bytes: int) -> BufferedReader:
    """Open a regular file of limited size for reading.

    Raises
    ------
    OSError
        There is none, it is not a regular file, or it has more than ``most_bytes``.
    """
    try:
        # Without O_NONBLOCK the open of a pipe waits until somebody writes to it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a name with NUL, or one that the file system's encoding does not have
        raise OSError(errno.EINVAL, f"no file can have this name: {error}") from None
    file = os.fdopen(descriptor, "rb") if _is_regular(descriptor) else None
    if file is None:
        kind = _KINDS.get(stat.S_IFMT(os.fstat(descriptor).st_mode), "something else")
        os.close(descriptor)
        raise OSError(errno.EINVAL, f"found {kind}, expected a file")
    size = os.fstat(descriptor).st_size
    if size > most_bytes:
        file.close()
        raise OSError(errno.EFBIG, f"found {size / 1e6:.1f} MB, expected at most {most_bytes / 1e6:g} MB")
    return file


def _is_regular(descriptor: int) -> bool:
    return stat.S_ISREG(os.fstat(descriptor).st_mode)


def read_text(path: Path | str, most_bytes: int) -> str:
    """The text of a regular file of limited size, in UTF-8 with or without a byte order mark, lines ended by ``\\n``.

    Raises
    ------
    OSError
        As `open_input`, or it is not UTF-8.
    """
    with open_input(path, most_bytes) as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:  # files of /proc say that they are empty
        raise OSError(errno.EFBIG, f"found more than {most_bytes / 1e6:g} MB, expected at most that")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, not_utf8(content, error)) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def not_utf8(content: bytes, error: UnicodeDecodeError) -> str:
    """What to say of text that is not UTF-8; ``content`` is the text from its beginning on."""
    if content.startswith(_UTF_16):
        return "found text in UTF-16, expected UTF-8"
    line = content.count(b"\n", 0, error.start) + 1
    return f"line {line}: found the byte 0x{error.object[error.start]:02x}, expected text in UTF-8"


def printable(text: str) -> str:
    """``text`` with every control character but tab and line feed as its escape sequence.

    Examples
    --------
    >>> printable("red \\x1b[31m")
    'red \\\\x1b[31m'
    """
    return CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def file_stem(name: str) -> str:
    """``name`` as part of a file name: letters, digits, underscores, dots and dashes, none of the last two in front.

    Examples
    --------
    >>> file_stem("../[red] pallet 1.5")
    'red_pallet_1.5'
    """
    return re.sub(r"[^\w.-]+", "_", name).strip("_.-")[:40] or "_"


@contextmanager
def making(path: Path | str) -> Iterator[Path]:
    """Where to write a new file: under another name in its folder, from which it is renamed once it is whole.

    Raises
    ------
    FileExistsError
        There is a file at ``path``; none is overwritten.
    """
    path = Path(path)
    _refuse_existing(path)
    unfinished = path.with_name(f".{path.name}.new")
    unfinished.unlink(missing_ok=True)
    try:
        yield unfinished
        _refuse_existing(path)
        os.rename(unfinished, path)
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
