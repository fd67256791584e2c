"""YAML that nobody should write: each has a line with its place, at once."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from msp_range.yaml_file import ConfigError, Section, load, read_yaml
from msp_range.yaml_loader import MOST_NODES, load_yaml
from tests.support.shipped import CONFIGS


class Entry(Section):
    """An entry of the file below."""

    name: str = ""
    """a name"""


class File(Section):
    """A file of a few keys."""

    number: float | None = None
    """a number"""
    whole: int | None = None
    """a whole number"""
    text: str | None = None
    """a text"""
    entries: tuple[Entry, ...] = ()
    """some entries"""


def error_of(tmp_path: Path, text: str | bytes) -> str:
    """What is reported of a file of this content, without its path."""
    path = tmp_path / "a.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    started_s = time.process_time()
    with pytest.raises(ConfigError) as raised:
        load(path, File)
    assert time.process_time() - started_s < 1.0
    assert str(raised.value).startswith(str(path))
    return str(raised.value).replace(str(path), "a.yaml")


def laughs(levels: int) -> str:
    """Lists of aliases of lists of aliases: 9 ** levels values."""
    return "\n".join(["a0: &a0 x", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels))])


def merges(levels: int) -> str:
    """The same with merge keys."""
    return "\n".join(
        ["m0: &m0 {a: 1}", *(f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 9)}]}}" for i in range(1, levels))]
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 900, "a.yaml:1:33: not valid YAML: found more than 32 mappings and lists inside each other"),
        # Of more, libyaml's own limit comes first in some versions.
        ("[" * 100_000, "not valid YAML: "),
        ("{a: " * 100_000, "found more than 32 mappings and lists inside each other"),
        ("- " * 100_000, "found more than 32 mappings and lists inside each other"),
        (laughs(60), "found more than 20000 values, aliases counted as what they stand for"),
        (merges(60), "found more than 20000 values, aliases counted as what they stand for"),
        ("entries: [" + "{}, " * MOST_NODES + "]", "found more than 20000 values"),
        ("entries: &a [*a]", "a.yaml:1:14: not valid YAML: *a is inside &a itself"),
        ("text: &a {b: *a}", "*a is inside &a itself"),
        ("? [a]\n: 1", "a.yaml:1:3: not valid YAML: found a list as a key, expected a word"),
        ("{{a: 1}: 2}", "found a mapping as a key, expected a word"),
        ("<<: 5", "expected a mapping or list of mappings for merging, but found 5"),
        ("text: a\ntext: b", "a.yaml:2:1: not valid YAML: the key 'text' is given twice"),
        (
            "text: !!python/object:os.system x",
            "found the tag !!python/object:os.system, expected a value without a tag",
        ),
        ("whole: 010", "a.yaml:1:8: not valid YAML: found 010, which may be read as an octal number"),
        ("number: 1.0e+999", "found 1.0e+999, expected a number of at most 1e+12"),
        ("number: 1e999", "a.yaml:1:9: not valid YAML: found 1e999, expected a number of at most 1e+12"),
        ("number: .nan", "number: found nan; expected a finite number"),
        ("number: 1e308", "found 1e308, expected a number of at most 1e+12"),
        ("whole: " + "9" * 5000, "expected a number of at most 1e+12"),
        ("whole: 0x" + "f" * 5000, "expected a number of at most 1e+12"),
        (
            "text: 5 \x00",
            "a.yaml: cannot be read: line 1, column 9: found the control character '\\x00', expected text without any",
        ),
        ('text: "\\e[31m"', "a.yaml:1:7: not valid YAML: found the control character '\\x1b', expected text"),
        ("text: '\u202e'", "found the control character '\\u202e'"),
        (b"text: M\xf6we", "a.yaml: cannot be read: line 1, column 8: found the byte 0xf6, expected text in UTF-8"),
        ("text: a".encode("utf-16"), "a.yaml: cannot be read: line 1, column 1: found UTF-16, expected text in UTF-8"),
        ("# " + "x" * 2**20, "a.yaml: cannot be read: found 1.0 MB, expected at most 1.04858 MB"),
        ("text: a\n---\ntext: b", "but found another document"),
        ("", "a.yaml: found nothing, expected a mapping with the keys number, whole, text, entries"),
    ],
)
def test_each_has_a_line_with_its_place(tmp_path: Path, text: str | bytes, message: str) -> None:
    assert message in error_of(tmp_path, text)


def test_only_the_first_user_errors_of_many_are_reported_and_each_is_short(tmp_path: Path) -> None:
    lines = error_of(tmp_path, "entries: [" + "{nam: 1}, " * 5000 + "]").split("\n")
    assert lines[0] == "a.yaml: entries[0].nam: unknown key. Did you mean 'name'? Known keys here: name"
    assert len(lines) == 21
    assert lines[-1] == "a.yaml: and 980 more"
    (long,) = error_of(tmp_path, f"{'k' * 100_000}: 1").split("\n")
    assert len(long) < 1100


def test_anchors_and_merge_keys_work_and_dates_and_times_stay_text() -> None:
    text = "a: &a {x: 0x70, y: 2026-13-45, z: 12:30}\nb: &b {<<: *a, y: 1.5}\nc: {<<: [*b], z: [*a]}"
    first = {"x": 112, "y": "2026-13-45", "z": "12:30"}
    assert load_yaml(text) == {"a": first, "b": {**first, "y": 1.5}, "c": {"x": 112, "y": 1.5, "z": [first]}}


def test_of_several_merged_mappings_the_first_counts_and_an_empty_one_adds_nothing() -> None:
    text = "a: &a {x: 1, y: 1}\nb: &b {y: 2, z: 2}\nc: {z: 3, <<: [*a, *b]}\nd: {<<: {}, x: 4}\ne: {'<<': 5}"
    found = load_yaml(text)
    assert [found[name] for name in "cde"] == [{"x": 1, "y": 1, "z": 3}, {"x": 4}, {"<<": 5}]


def test_files_of_the_project_are_read_as_by_the_package(tmp_path: Path) -> None:
    paths = sorted(CONFIGS.rglob("*.yaml"))
    assert len(paths) > 30
    for path in paths:
        # repr distinguishes 1, 1.0 and True.
        assert repr(read_yaml(path)) == repr(yaml.safe_load(path.read_text()))
    # What the package writes comes back, also text that looks like a number.
    words = ["010", "08", "0x7", "1e5", "12:30", "2026-10-05", "yes", "~", "<<", "=", "1_0", "a: b", "#"]
    assert load_yaml(yaml.safe_dump(words)) == words


def test_a_pipe_and_a_device_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(ConfigError, match=r"pipe\.yaml: cannot be read: found a pipe, expected a file"):
        read_yaml(tmp_path / "pipe.yaml")
    with pytest.raises(ConfigError, match="/dev/zero: cannot be read: found a device, expected a file"):
        read_yaml(Path("/dev/zero"))


def test_without_the_parser_in_c_it_is_the_same(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['yaml._yaml'] = None\n"
        "from msp_range.yaml_loader import load_yaml, yaml\n"
        "assert not yaml.__with_libyaml__\n"
        f"print(load_yaml(open({str(CONFIGS / 'quad_pallet.yaml')!r}).read()))\n"
        "try: load_yaml('[' * 40)\n"
        "except yaml.YAMLError as error: print(error.problem)\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    read, refused = out.splitlines()
    assert read == repr(read_yaml(CONFIGS / "quad_pallet.yaml"))
    assert refused == "found more than 32 mappings and lists inside each other"
