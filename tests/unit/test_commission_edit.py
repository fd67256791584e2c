"""Changing values of a YAML file: comments stay, the rest stays, a backup is kept."""

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from msp_range.commission.edit import Address, Edit, change, edited
from msp_range.yaml_file import ConfigError

TEXT = """\
# a vehicle
sensors:
  - {name: one, address: 0x70, position_m: [0.25, -0.20, 0.05], rotation_deg: {pitch: -90}}  # the left one
  - name: two  # by the rear
    address: 0x71
    rotation_deg:
      pitch: -90  # down

temperature:
  fixed_c: 20
"""


@pytest.mark.parametrize(
    ("edits", "old", "new"),
    [
        ([Edit(("sensors", 0, "address"), Address(0x73))], "address: 0x70", "address: 0x73"),
        ([Edit(("sensors", 0, "position_m", 1), 0.2)], "-0.20, 0.05]", "0.2, 0.05]"),
        ([Edit(("sensors", 0, "rotation_deg", "yaw"), 90)], "{pitch: -90}", "{pitch: -90, yaw: 90}"),
        ([Edit(("sensors", 1, "rotation_deg", "yaw"), 90)], "# down\n", "# down\n      yaw: 90\n"),
        ([Edit(("temperature", "fixed_std_c"), 3.0)], "fixed_c: 20\n", "fixed_c: 20\n  fixed_std_c: 3.0\n"),
        ([Edit(("sensors", 1, "name"), "yes: no")], "name: two ", 'name: "yes: no" '),
        (
            [Edit(("sensors", 0, "address"), Address(0x71)), Edit(("sensors", 1, "address"), Address(0x70))],
            "",
            "",
        ),
    ],
)
def test_only_the_value_changes(edits: list[Edit], old: str, new: str) -> None:
    found = edited(TEXT, edits)
    if old:
        assert found == TEXT.replace(old, new, 1)
    assert found.count("#") == TEXT.count("#")


@pytest.mark.parametrize(
    ("text", "edit"),
    [
        ("a: &here [1, 2]\nb: *here\n", Edit(("b", 0), 3)),
        ("a: 1\n", Edit(("b", "c"), 3)),
        ("a: []\n", Edit(("a", 0), 3)),
        ("a: {}\n", Edit(("a", "b"), 3)),
    ],
)
def test_what_cannot_be_changed_alone_is_refused(text: str, edit: Edit) -> None:
    with pytest.raises(ConfigError, match="by hand"):
        edited(text, [edit])


def test_every_change_keeps_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "airframe.yaml"
    path.write_text("bus: 1\n")
    path.chmod(0o640)
    group = 12345 if os.geteuid() == 0 else os.getegid()
    os.chown(path, -1, group)
    backups: list[Any] = [change(path, [Edit(("bus",), number)]) for number in (2, 3)]
    assert [each.name for each in backups] == ["airframe.yaml.1", "airframe.yaml.2"]
    assert [each.read_text() for each in backups] == ["bus: 1\n", "bus: 2\n"]
    assert path.read_text() == "bus: 3\n"
    assert path.stat().st_mode & 0o777 == 0o640
    assert path.stat().st_gid == group
    assert len(list(tmp_path.iterdir())) == 3


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "airframe.yaml"
    path.write_text("bus: 1\n")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ConfigError, match="No space left"):
        change(path, [Edit(("bus",), 2)])
    assert path.read_text() == "bus: 1\n"
    assert [*tmp_path.iterdir()] == [path]
