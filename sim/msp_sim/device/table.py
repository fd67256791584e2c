"""The emulated range finders, by the name that sensor model files give their driver.

A new one is a file next to this one and a line in `EMULATED`; a package of somebody else's adds its own as an entry
point of the group `GROUP`. Only the standard library is used, as in the devices themselves.
"""

from importlib.metadata import entry_points

from msp_sim.device.device import RangeFinder
from msp_sim.device.lidar_lite_v3 import EmulatedLidarLiteV3
from msp_sim.device.maxsonar import EmulatedMaxSonarCm, EmulatedMaxSonarMm, EmulatedMaxSonarMm10m
from msp_sim.device.mb1242 import EmulatedMB1242

GROUP = "msp_sim.devices"
"""Entry points of installed packages that are emulated range finders."""


EMULATED: dict[str, type[RangeFinder]] = {
    "mb1242": EmulatedMB1242,
    "lidar_lite_v3": EmulatedLidarLiteV3,
    "maxsonar_cm": EmulatedMaxSonarCm,
    "maxsonar_mm": EmulatedMaxSonarMm,
    "maxsonar_mm_10m": EmulatedMaxSonarMm10m,
}
"""Emulated range finders by the driver's name in model files."""


def emulated_kind(driver: str) -> type[RangeFinder]:
    """The emulated range finder that speaks to a driver.

    Raises
    ------
    ValueError
        There is none.
    """
    if driver in EMULATED:
        return EMULATED[driver]
    for entry in entry_points(group=GROUP, name=driver):
        kind: type[RangeFinder] = entry.load()
        return kind
    raise ValueError(f"no emulated range finder for the driver {driver!r}; there are {', '.join(EMULATED)}")
