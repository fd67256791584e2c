"""The kinds of range finders that a sensor model file may name as its ``driver``.

A new one is a file next to this one and a line in `DRIVERS`. A package of somebody else's adds its own without a change
here, as an entry point of the group `GROUP`: the name is what model files say, the value a class that is a `Driver`.
"""

from collections.abc import Iterator

from msp_range.plugins import installed, load_entry
from msp_range.sensors.base import Driver
from msp_range.sensors.lidar_lite_v3 import LidarLiteV3
from msp_range.sensors.mb1242 import MB1242

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
    return [*DRIVERS, *sorted(installed(GROUP).keys() - DRIVERS.keys()), NONE]


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
    others = installed(GROUP)
    if name in others:
        driver: type[Driver] = load_entry(others[name], "driver", Driver)
        return driver
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
    for name, entry in installed(GROUP).items():
        if name not in DRIVERS:
            yield load_entry(entry, "driver", Driver)
