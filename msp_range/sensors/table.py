"""The kinds of range finders that a sensor model file may name as its ``driver``.

A new one is a file next to this one and a line in `DRIVERS`. Other packages add theirs by an entry point of the group
`GROUP`, whose name is used in model files and whose value is a class derived from `Driver`.
"""

from collections.abc import Iterator

from msp_range.plugins import installed, load_entry
from msp_range.sensors.base import Driver
from msp_range.sensors.lidar_lite_v3 import LidarLiteV3
from msp_range.sensors.maxsonar import MaxSonarCm, MaxSonarMm, MaxSonarMm10m
from msp_range.sensors.mb1242 import MB1242

GROUP = "msp_range.drivers"
"""Group of the entry points of installed packages with drivers."""
NONE = "none"
"""Name in a model file for a sensor without a driver, whose readings can be characterised but which cannot fly."""

DRIVERS: dict[str, type[Driver]] = {
    "mb1242": MB1242,
    "lidar_lite_v3": LidarLiteV3,
    "maxsonar_cm": MaxSonarCm,
    "maxsonar_mm": MaxSonarMm,
    "maxsonar_mm_10m": MaxSonarMm10m,
}
"""Drivers by their name in model files. The first one is the default if the kind of sensor is not stated: for a table
of readings without an airframe, or a device at an address that is not any driver's default."""


def driver_names() -> list[str]:
    """Names that a model file may use."""
    return [*DRIVERS, *sorted(installed(GROUP).keys() - DRIVERS.keys()), NONE]


def find_driver(name: str) -> type[Driver] | None:
    """The driver of a name; None for `NONE`.

    Raises
    ------
    ValueError
        No driver has the name.
    ConfigError
        The package with the driver cannot be used.
    """
    if name == NONE:
        return None
    if name in DRIVERS:
        return DRIVERS[name]
    others = installed(GROUP)
    if name in others:
        driver: type[Driver] = load_entry(others[name], "driver", Driver)
        return driver
    *names, last = [repr(name) for name in driver_names()]
    raise ValueError(f"expected {', '.join(names)} or {last}")


def drivers_at(address: int) -> list[type[Driver]]:
    """Kinds of sensors that may be at an address: those with this default address, then the first of all."""
    kinds = [*_all_drivers()]
    return list(dict.fromkeys([*(kind for kind in kinds if kind.default_address == address), kinds[0]]))


def longest_busy_s() -> float:
    """Longest time for which a sensor of any kind may not acknowledge while it measures [s]."""
    return max(kind.busy_s for kind in _all_drivers())


def _all_drivers() -> Iterator[type[Driver]]:
    yield from DRIVERS.values()
    for name, entry in installed(GROUP).items():
        if name not in DRIVERS:
            yield load_entry(entry, "driver", Driver)
