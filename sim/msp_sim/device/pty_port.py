"""An emulated serial sensor behind a pseudoterminal, which every program opens as it opens a serial adapter.

The kernel's own terminal driver carries the bytes. Only the standard library is used.
"""

import os
import pty
import select
import tty
from pathlib import Path

from msp_sim.device.device import NotAcknowledged, RangeFinder
from msp_sim.device.maxsonar import Unplugged


class PtyPort:
    """A device file whose bytes come from an emulated sensor; it vanishes where the sensor is unplugged.

    Parameters
    ----------
    path
        Name of the device file, a link to the pseudoterminal.
    sensor
        Sends what is due at each call of `pump`.
    """

    def __init__(self, path: Path, sensor: RangeFinder) -> None:
        self._path, self._sensor = path, sensor
        self._files: tuple[int, ...] = ()

    def pump(self) -> None:
        """Put the bytes that the sensor has sent by now into the port, and return when they can be read."""
        try:
            arrived = self._sensor.read(64)
        except Unplugged:
            self.unplug()
            return
        except NotAcknowledged:
            arrived = b""
        if not self._files:
            # The other end stays open here: without it a port that nobody has open would be an error.
            self._files = pty.openpty()
            tty.setraw(self._files[1])
            self._path.symlink_to(os.ttyname(self._files[1]))
        if arrived:
            os.write(self._files[0], arrived)
            # The kernel passes them on in a thread of its own.
            select.select(self._files[1:], (), ())

    def unplug(self) -> None:
        """Take the device away: whoever has it open gets an error."""
        self._path.unlink(missing_ok=True)
        for file in self._files:
            os.close(file)
        self._files = ()
