"""The kinds of range finders that a sensor model file may name as its ``driver``.

A new one is a file next to this one and a line in `DRIVERS`. A package of somebody else's adds its own without a change
here, as an entry point of the group `GROUP`: the name is what model files say, the value a class that is a `Driver`.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from msp_range.sensors.base import Driver
from msp_range.sensors.lidar_lite_v3 import LidarLiteV3
from msp_range.sensors.mb1242 import MB1242
from msp_range.yaml_file import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "msp_range.drivers"
"""Entry points of installed packages that are drivers."""
NONE = "none"
"""In a model file: there is no driver, so its readings are characterised and it does not fly."""

DRIVERS: dict[str, type[Driver]] = {
    "mb1242": MB1242,
    "lidar_lite_v3": LidarLiteV3,
}
"""By the name in model files. The first one is asked for where nothing says which kind a sensor is: a table of readings
without an airframe, a device at an address that is no driver's default one."""


def default_driver() -> type[Driver]:
    """The driver of sensors of which nothing says what they are."""
    return next(iter(DRIVERS.values()))


def driver_names() -> list[str]:
    """What a model file may name."""
    return [*DRIVERS, *sorted({each.name for each in _installed()} - DRIVERS.keys()), NONE]


def find_driver(name: str) -> type[Driver] | None:
    """The driver of a name; None for `NONE`.

    Raises
    ------
    ValueError
        No driver has the name.
    ConfigError
        The package that offers it cannot be used.
    """
    if name == NONE:
        return None
    if name in DRIVERS:
        return DRIVERS[name]
    for entry in _installed():
        if entry.name == name:
            return _load(entry)
    *names, last = [repr(each) for each in driver_names()]
    raise ValueError(f"expected {', '.join(names)} or {last}")


def drivers_at(address: int) -> list[type[Driver]]:
    """Kinds of sensors that may be at an address: those that come with it, then the default one."""
    kinds = [kind for kind in _all_drivers() if kind.default_address == address]
    return list(dict.fromkeys([*kinds, default_driver()]))


def longest_busy_s() -> float:
    """The longest time for which a sensor of any kind may not acknowledge while it ranges [s]."""
    return max(kind.busy_s for kind in _all_drivers())


def _all_drivers() -> Iterator[type[Driver]]:
    yield from DRIVERS.values()
    for entry in _installed():
        if entry.name not in DRIVERS:
            yield _load(entry)


def _installed() -> "Iterator[EntryPoint]":
    """Drivers of other packages. Its import takes some of the bridge's start, so only for what is not built in."""
    from importlib.metadata import entry_points

    yield from entry_points(group=GROUP)


def _load(entry: "EntryPoint") -> type[Driver]:
    try:
        driver = entry.load()
    except Exception as error:  # Whatever somebody else's package does at its import is a mistake there.
        raise ConfigError(f"the driver {entry.name!r} ({entry.value}) cannot be loaded: {error}") from error
    if not (isinstance(driver, type) and issubclass(driver, Driver)):
        raise ConfigError(f"the driver {entry.name!r} ({entry.value}) is no class derived from {Driver.__qualname__}")
    return driver
