"""Some numbers of a serialized ROS message, without making an object of the message, which takes ten times as long.

They are where the lengths of its texts put them: the parts before, between and behind the texts are formats of `struct`
in which what is not asked for is skipped. Messages with sequences have no such parts. Formats:
https://wiki.ros.org/msg and the OMG's CDR, in which each number is aligned to its own size.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype

_LETTERS = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_TEXT = "string"
_LITTLE_ENDIAN = b"\0\1"
"""What a message in CDR begins with; the others are left to rosbags."""
_CDR_HEADER_BYTES = 4

Numbers = Callable[[bytes], list[float] | None]
"""Makes the numbers of a message's bytes; None: rosbags has to be asked, which knows what is wrong with them."""


def numbers_of(store: Any, kind: str, is_ros1: bool, paths: Sequence[str]) -> Numbers | None:
    """What finds the numbers with these paths in messages of a type of a store of rosbags; None: nothing can."""
    try:
        fields = list(_fields(store, kind, ""))
    except LookupError:
        return None
    if not set(paths) <= {path for path, _ in fields}:
        return None
    places = [path for path, _ in fields if path in paths]
    order = [places.index(path) for path in paths]
    parts: list[list[str]] = [[]]
    for path, base in fields:
        if base == _TEXT:
            parts[-1].append("I")
            parts.append([])
        else:
            letter = _LETTERS[base]
            parts[-1].append(letter if path in paths else f"{struct.calcsize(letter)}x")
    begin = 0 if is_ros1 else _CDR_HEADER_BYTES

    @cache
    def part(number: int, aligned_at: int) -> struct.Struct:
        """The format of a part that begins so many bytes behind a multiple of 8."""
        form, at = "<", aligned_at
        for each in parts[number]:
            size = struct.calcsize(each)
            gap = 0 if is_ros1 else -at % size
            form += f"{gap}x{each}"
            at += gap + size
        return struct.Struct(form)

    def numbers(content: bytes) -> list[float] | None:
        if not is_ros1 and content[:2] != _LITTLE_ENDIAN:
            return None
        found: list[float] = []
        at = begin
        for number in range(len(parts)):
            form = part(number, (at - begin) % 8)
            if at + form.size > len(content):
                return None
            found += form.unpack_from(content, at)
            at += form.size
            if number + 1 < len(parts):
                length = int(found.pop())
                if not content[at : at + length].isascii():
                    return None
                at += length
        return [found[place] for place in order] if at == len(content) else None

    return numbers


def _fields(store: Any, kind: str, way: str) -> Iterator[tuple[str, str]]:
    """Paths of the numbers and texts of a type in the order of their bytes, with their basic types.

    Raises
    ------
    LookupError
        It has others, or sequences.
    """
    for name, (node, about) in store.fielddefs[kind][1]:
        path = f"{way}{name}"
        if node == Nodetype.NAME:
            yield from _fields(store, about, f"{path}.")
            continue
        (node, about), length = about if node == Nodetype.ARRAY else ((node, about), None)
        if node != Nodetype.BASE or about[0] not in (*_LETTERS, _TEXT):
            raise LookupError(f"{path} is no number")
        yield from [(path, about[0])] if length is None else [(f"{path}.{place}", about[0]) for place in range(length)]
