"""Change single values of a YAML file and leave everything else as it is, comments included.

The new text goes where YAML's own parser found the old value. The result is read again and compared with what it should
be before anything is written, and the file as it was is kept next to it.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from msp_range.input_file import making
from msp_range.yaml_file import ConfigError, Place, place_of, read_config, with_value, writing
from msp_range.yaml_loader import load_yaml

MOST_BACKUPS = 999
"""Backups of one file; nobody makes more in the life of a vehicle."""


class Edit(NamedTuple):
    """A place in a file, as keys and indices, and its new value."""

    path: Place
    value: Any


def edited(text: str, edits: Sequence[Edit]) -> str:
    """The text of a YAML file with some values changed.

    Raises
    ------
    ConfigError
        The text cannot be changed so, for example because two places share one value by an anchor.

    Examples
    --------
    >>> print(edited("bus: 1  # of the Pi\\n", [Edit(("bus",), 3)]), end="")
    bus: 3  # of the Pi
    """
    wanted = load_yaml(text)
    for edit in edits:
        text = _replaced(text, edit)
        wanted = with_value(wanted, *edit)
    if load_yaml(text) != wanted:
        places = "; ".join(f"{place_of(edit.path)}: {as_yaml(edit.value)}" for edit in edits)
        raise ConfigError(f"this file has to be changed by hand, as parts of it are used in several places: {places}")
    return text


def save(path: Path, text: str) -> Path:
    """Replace a file, keeping the one that was there as the first free of FILE.1, FILE.2 ...; return that name.

    Where there is none, it is made, and its own name returned.

    Raises
    ------
    ConfigError
        The file cannot be written.
    """
    if not path.exists():
        with writing(path), making(path) as new:
            new.write_text(text, encoding="utf-8")
        return path
    try:
        backup = _free_name(path)
        with making(path, replacing=True) as new:
            with new.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())  # after a power cut there is the old file or the new one
            before = path.stat()
            if (new.stat().st_uid, new.stat().st_gid) != (before.st_uid, before.st_gid):
                os.chown(new, before.st_uid, before.st_gid)  # root edits a file that the service's user has to read
            new.chmod(before.st_mode & 0o777)
            with making(backup) as kept:
                kept.write_bytes(path.read_bytes())
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be changed: {error.strerror}. Use sudo, or a copy of the file that you may write"
        ) from None
    return backup


def change(path: Path, edits: Sequence[Edit]) -> Path:
    """Change values in a file; return the backup's name. Raises ConfigError as `edited` and `save`."""
    return save(path, edited(read_config(path), edits))


def _free_name(path: Path) -> Path:
    for number in range(1, MOST_BACKUPS + 1):
        name = path.with_name(f"{path.name}.{number}")
        if not name.exists():
            return name
    raise ConfigError(f"{path}: there are {MOST_BACKUPS} backups ({path.name}.1 and so on); remove the oldest")


def _replaced(text: str, edit: Edit) -> str:
    node: yaml.Node | None = yaml.compose(text, Loader=yaml.SafeLoader)
    if node is None:
        raise ConfigError("the file is empty")
    for key in edit.path[:-1]:
        node = _child(node, key)
    found = _child(node, edit.path[-1])
    if found is None:
        return _inserted(text, node, edit)
    return text[: found.start_mark.index] + as_yaml(edit.value) + text[found.end_mark.index :]


def _child(node: yaml.Node | None, key: int | str) -> yaml.Node | None:
    children: dict[int | str, yaml.Node] = {}
    if isinstance(node, yaml.SequenceNode):
        children = dict(enumerate(node.value))
    elif isinstance(node, yaml.MappingNode):
        children = {name.value: value for name, value in node.value}
    return children.get(key)


def _inserted(text: str, mapping: yaml.Node | None, edit: Edit) -> str:
    """The text with a key added to a mapping, after its last value."""
    if not isinstance(mapping, yaml.MappingNode) or not mapping.value:
        raise ConfigError(f"{place_of(edit.path)}: not found in the file as it is written; change it by hand")
    line = f"{edit.path[-1]}: {as_yaml(edit.value)}"
    name, value = mapping.value[-1]
    end: int = value.end_mark.index
    if mapping.flow_style:
        return f"{text[:end]}, {line}{text[end:]}"
    # A block's value may end after line ends and comments; the new line follows the last line with content.
    end = len(text[:end].rstrip())
    line_end = text.find("\n", end)
    line_end = len(text) if line_end < 0 else line_end
    return f"{text[:line_end]}\n{' ' * name.start_mark.column}{line}{text[line_end:]}"


def as_yaml(value: Any) -> str:
    """A value as it stands in the file, in one line."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(as_yaml, value))}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {as_yaml(part)}" for key, part in value.items()) + "}"
    if isinstance(value, Address):
        return f"0x{value:02x}"
    if isinstance(value, float):
        return f"{value:.10g}" if value != int(value) else f"{value:.1f}"
    if isinstance(value, str):
        text: str = yaml.safe_dump(value, default_style='"', width=10_000).strip()
        return text
    return str(value)


class Address(int):
    """A number that is written in hexadecimal."""
