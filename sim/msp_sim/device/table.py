"""The emulated range finders, by the name that sensor model files give their driver.

A new one is a file next to this one and a line in `EMULATED`; a package of somebody else's adds its own as an entry
point of the group `GROUP`. Only the standard library is used, as in the devices themselves.
"""

import random
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Protocol

from msp_sim.device.bus import Device
from msp_sim.device.device import DeviceTiming, Fault
from msp_sim.device.lidar_lite_v3 import EmulatedLidarLiteV3
from msp_sim.device.mb1242 import EmulatedMB1242

GROUP = "msp_sim.devices"
"""Entry points of installed packages that are emulated range finders."""


class EmulatedKind(Protocol):
    """Makes one: address, time [s], reading [cm] by the time of a ping [s], timing, faults, chance of the faults."""

    default_timing: DeviceTiming
    """How long such a sensor is busy."""
    minimum_cm: int
    """Shortest reading [cm]."""
    no_echo_cm: int
    """Reading without an echo, beyond the longest [cm]."""

    def check_fault(self, fault: Fault) -> None:
        """Raise ValueError where such a sensor cannot show a fault."""

    def __call__(
        self,
        address: int,
        now: Callable[[], float],
        echo: Callable[[float], int],
        timing: DeviceTiming | None = ...,
        faults: Sequence[Fault] = ...,
        chance: random.Random | None = ...,
    ) -> Device: ...


EMULATED: dict[str, EmulatedKind] = {
    "mb1242": EmulatedMB1242,
    "lidar_lite_v3": EmulatedLidarLiteV3,
}
"""By the driver's name in model files."""


def emulated_kind(driver: str) -> EmulatedKind:
    """The emulated range finder that speaks to a driver.

    Raises
    ------
    ValueError
        There is none.
    """
    if driver in EMULATED:
        return EMULATED[driver]
    for entry in entry_points(group=GROUP, name=driver):
        kind: EmulatedKind = entry.load()
        return kind
    raise ValueError(f"no emulated range finder for the driver {driver!r}; there are {', '.join(EMULATED)}")
