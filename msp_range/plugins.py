"""Drivers, filters and effects of other packages, which name theirs as entry points of a group.

An installed package's ``pyproject.toml`` says, for example::

    [project.entry-points."msp_range.filters"]
    my_filter = "my_package.my_filter:MyFilterParameters"

Nothing is imported before a file names it, so that a package that cannot be used stops nobody else.
"""

from typing import TYPE_CHECKING, Any

from msp_range.yaml_file import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


def installed(group: str) -> "dict[str, EntryPoint]":
    """Entry points of a group by name. The search takes 4 ms of a start, so it is only for what is not built in."""
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=group)}


def load_entry(entry: "EntryPoint", what: str, expected: type) -> Any:
    """The object of an entry point.

    Parameters
    ----------
    entry
        As `installed` returns it.
    what
        What it is, for messages: "driver", "filter", "effect".
    expected
        A class: what is loaded is an object of it or a class derived from it.

    Raises
    ------
    ConfigError
        It cannot be imported, or is something else.
    """
    try:
        found = entry.load()
    except Exception as error:  # Whatever somebody else's package does at its import is a mistake there.
        raise ConfigError(f"the {what} {entry.name!r} ({entry.value}) cannot be loaded: {error}") from error
    if isinstance(found, expected) or (isinstance(found, type) and issubclass(found, expected)):
        return found
    raise ConfigError(
        f"the {what} {entry.name!r} ({entry.value}) is no {expected.__qualname__} and no class derived from it"
    )
