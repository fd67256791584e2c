"""Devices on a bus that are no range finders."""

from collections.abc import Sequence

from msp_sim.device.device import Fault


class PlainDevice:
    """Something else on the bus: it acknowledges everything and answers with the same bytes.

    An SHTC3, a PCA9685 and a TCA9548A share addresses with range finders, and none of them is one.

    Parameters
    ----------
    address
        7-bit address.
    answer
        What it sends, followed by 0xFF for as long as the master asks.
    faults
        Only "locked_up" has an effect: a device other than a range finder can hold the bus.
    """

    also_at: int | None = None
    busy_until_s = float("-inf")

    def __init__(self, address: int, answer: bytes = b"", faults: Sequence[Fault] = ()) -> None:
        self.address: int | str = address
        self.faults = tuple(faults)
        self._answer = answer

    def write(self, data: bytes) -> None:
        """Acknowledge ``data``."""

    def read(self, count: int) -> bytes:
        """Return the answer, cut or filled to ``count`` bytes."""
        return self._answer.ljust(count, b"\xff")[:count]
