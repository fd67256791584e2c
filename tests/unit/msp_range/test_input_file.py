"""What users name as a file, and is none: refused at once, in words."""

import os
import socket
from pathlib import Path

import pytest

from msp_range.input_file import file_stem, making, open_input, printable, read_text


def refusal(path: Path | str, most_bytes: int = 1000) -> str:
    """What is reported of a file that cannot be read."""
    try:
        read_text(path, most_bytes)
    except OSError as error:
        return str(error.strerror)
    raise AssertionError("it was read")


def test_a_file_is_read_with_or_without_a_byte_order_mark_and_with_any_end_of_line(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfM\xc3\xb6we\r\na\rb\n")
    assert read_text(tmp_path / "a", 1000) == "Möwe\na\nb\n"


def test_what_is_no_regular_file_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        assert refusal(tmp_path / "pipe") == "found a pipe, expected a file"
        assert refusal(tmp_path) == "found a directory, expected a file"
        assert refusal("/dev/zero") == "found a device, expected a file"
        assert refusal(tmp_path / "socket") == "No such device or address"
    assert refusal(tmp_path / "none") == "No such file or directory"
    assert refusal("a\x00b") == "no file can have this name: embedded null byte"
    assert refusal("a" * 300) == "File name too long"


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(2**40)
    assert refusal(tmp_path / "sparse") == "found 1099511.6 MB, expected at most 0.001 MB"
    (tmp_path / "a").write_bytes(bytes(1000))
    with open_input(tmp_path / "a", 1000) as file:
        assert file.read() == bytes(1000)
    # A file of /proc has no size.
    assert refusal("/proc/self/maps", 10) == "found more than 1e-05 MB, expected at most that"


def test_text_that_is_not_utf8_is_refused_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"one\ntwo\nM\xf6we\n")
    assert refusal(tmp_path / "a") == "line 3, column 2: found the byte 0xf6, expected text in UTF-8"
    (tmp_path / "b").write_bytes("a: 1".encode("utf-16"))
    assert refusal(tmp_path / "b") == "line 1, column 1: found UTF-16, expected text in UTF-8"


def test_what_a_terminal_would_obey_is_printed_as_its_escape_sequence() -> None:
    assert printable("a\tb\nMöwe \x1b[31m\x9b\x00\u202e") == "a\tb\nMöwe \\x1b[31m\\x9b\\x00\\u202e"


def test_a_name_as_part_of_a_file_name() -> None:
    assert file_stem("../../[red] pallet\x1b") == "red_pallet"
    assert file_stem("..") == "_"
    assert len(file_stem("Möwe" * 100).encode()) < 200


def test_a_new_file_is_there_when_it_is_whole_and_never_before(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(OSError, match="No such file"), making(out) as unfinished:
        unfinished.write_text(unfinished.with_name("none").read_text())
    with pytest.raises(UnicodeEncodeError), making(out) as unfinished:
        unfinished.write_text("half, and then \ud800", encoding="utf-8")
    assert os.listdir(tmp_path) == []
    (tmp_path / ".out.new").write_text("left behind by a power cut")
    with making(out) as unfinished:
        unfinished.write_text("whole")
        assert not out.exists()
    assert os.listdir(tmp_path) == ["out"]
    with pytest.raises(FileExistsError), making(out) as unfinished:
        unfinished.write_text("another")
    assert out.read_text() == "whole"
