"""Load drivers, filters and effects of other packages, which declare them as entry points of a group.

An installed package's ``pyproject.toml`` contains, for example::

    [project.entry-points."msp_range.filters"]
    my_filter = "my_package.my_filter:MyFilterParameters"

Nothing is imported before a file names it, so an unusable package does not affect others.
"""

from typing import TYPE_CHECKING, Any

from msp_range.yaml_file import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


def installed(group: str) -> "dict[str, EntryPoint]":
    """Entry points of a group by name. The search takes 4 ms, so it is done only for names that are not built in."""
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=group)}


def load_entry(entry: "EntryPoint", what: str, expected: type) -> Any:
    """The object of an entry point.

    Parameters
    ----------
    entry
        As `installed` returns it.
    what
        Kind of object, for messages: "driver", "filter", "effect".
    expected
        A class; the loaded object has to be an instance of it or a class derived from it.

    Raises
    ------
    ConfigError
        It cannot be imported, or has another type.
    """
    try:
        found = entry.load()
    except Exception as error:  # Any exception while importing another package is an error in that package.
        remedy = "; install the package that contains it" if isinstance(error, ModuleNotFoundError) else ""
        raise ConfigError(f"the {what} {entry.name!r} ({entry.value}) cannot be loaded: {error}{remedy}") from error
    if isinstance(found, expected) or (isinstance(found, type) and issubclass(found, expected)):
        return found
    raise ConfigError(
        f"the {what} {entry.name!r} ({entry.value}) is not a {expected.__qualname__} or a class derived from it"
    )
