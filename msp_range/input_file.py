"""Open files named by a user safely, whatever the name refers to.

Files are opened, or read as text, up to a size limit. Anything that is not a regular file (a directory, a pipe on which
opening would wait, an endless device) or that is too large is refused with an OSError whose ``strerror`` says what was
found and what was expected, so that callers can report it like a missing file.
"""

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
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\u202a-\u202e\u2066-\u2069]")
"""Characters that are not text: control characters except tab and line feed (terminals execute some of them), halves of
surrogate pairs (no encoding has them; Python decodes bytes that are not UTF-8 to them with ``surrogateescape``), and
those that change the direction of writing."""


def open_input(path: Path | str, most_bytes: int) -> BufferedReader:
    """Open a regular file of limited size for reading.

    Raises
    ------
    OSError
        There is no such file, it is not a regular file, or it is larger than ``most_bytes``.
    """
    try:
        # Without O_NONBLOCK opening a pipe waits for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a name with NUL, or one that the file system's encoding cannot represent
        raise OSError(errno.EINVAL, f"no file can have this name: {error}") from None
    found = os.fstat(descriptor)
    kind = stat.S_IFMT(found.st_mode)
    if kind == stat.S_IFREG and found.st_size <= most_bytes:
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if kind != stat.S_IFREG:
        raise OSError(errno.EINVAL, f"found {_KINDS.get(kind, 'something else')}, expected a file", str(path))
    raise OSError(errno.EFBIG, f"found {found.st_size / 1e6:.1f} MB, expected at most {most_bytes / 1e6:g} MB")


def read_text(path: Path | str, most_bytes: int) -> str:
    """The text of a regular file of limited size, in UTF-8 with or without a byte order mark, lines ended by ``\\n``.

    Raises
    ------
    OSError
        As for `open_input`, or the file is not UTF-8, or it contains control characters.
    """
    with open_input(path, most_bytes) as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:  # files in /proc have a size of 0
        raise OSError(errno.EFBIG, f"found more than {most_bytes / 1e6:g} MB, expected at most that")
    text = content.decode("utf-8-sig", "surrogateescape").replace("\r\n", "\n").replace("\r", "\n")
    if (fault := text_fault(text)) is not None:
        lines, column, words = fault
        raise OSError(errno.EILSEQ, f"line {lines + 1}, column {column + 1}: {words}")
    return text


def text_fault(text: str) -> tuple[int, int, str] | None:
    """Where and what the first of the characters is that are not text; None: all are.

    Parameters
    ----------
    text
        Decoded from UTF-8 with ``surrogateescape``, so that bytes that are not UTF-8 are found too.

    Returns
    -------
    (int, int, str) or None
        The number of line ends before it, that of characters before it in its line, and what was found and expected.

    Examples
    --------
    >>> text_fault("a\\nb\x1b")
    (1, 1, "found the control character '\\\\x1b', expected text without any")
    """
    control = CONTROL.search(text)
    if control is None:
        return None
    fault = f"found the control character {control[0]!r}, expected text without any"
    if "\udc80" <= control[0] <= "\udcff":
        is_utf16 = text.startswith(("\udcff\udcfe", "\udcfe\udcff"))
        fault = f"found {'UTF-16' if is_utf16 else f'the byte 0x{ord(control[0]) & 0xFF:02x}'}, expected text in UTF-8"
    at = control.start()
    return text.count("\n", 0, at), at - text.rfind("\n", 0, at) - 1, fault


def printable(text: str) -> str:
    """``text`` with control characters except tab and line feed as escape sequences.

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
def making(path: Path | str, *, replacing: bool = False) -> Iterator[Path]:
    """Write a new file under a temporary name in its folder, and rename it when it is complete.

    Raises
    ------
    FileExistsError
        ``path`` exists already, and is not to be replaced.
    """
    path = Path(path)
    if not replacing:
        _refuse_existing(path)
    unfinished = path.with_name(f".{path.name}.new")
    unfinished.unlink(missing_ok=True)
    try:
        yield unfinished
        if not replacing:
            _refuse_existing(path)
        os.replace(unfinished, path)
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
