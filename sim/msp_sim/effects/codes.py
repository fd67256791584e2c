"""Faults of the transmission: each turns the code of a reading into another one.

A fault affects a share of the readings. The probability of a received code is the sum over the codes that the fault
turns into it, so each fault can list those (`CodeFault.origins`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from msp_range.arrays import Array, Indices
from msp_range.reading_model.kernel import on_grid
from msp_range.sensors.mb1242 import CLOCK_FAULT_BIT

Origins = list[tuple[Array, Array]]
"""Ranges of sent codes, the first and the last of each, for each received code."""
PHASES = 10
"""So many places in a step, the multiples among them, are compared. More: slower, and the largest of more gains by
chance; fewer: chance is known less well."""


class CodeFault(Protocol):
    """One kind of fault.

    Attributes
    ----------
    order
        Faults are applied in this order, from the sensor to the master.
    """

    @property
    def order(self) -> int: ...

    def arrives(self, code: Array) -> Array:
        """The code that is received for each sent code."""

    def origins(self, first: Array, last: Array) -> Origins:
        """Ranges (first, last) of sent codes that are received as codes from first to last; empty if last < first.

        A fault that is not monotone supports single codes (first == last) and all codes up to one (first = -inf).
        """


@dataclass(frozen=True)
class Coarser:
    """Rounded to multiples of a step, then to the sensor's resolution; the sensor's limits are unchanged.

    ``from_cm`` is added to the multiples: nothing rounds to them with another number than 0, but what is read there
    shows what multiples would gain by chance.
    """

    step_cm: float
    minimum_cm: float
    maximum_cm: float
    resolution_cm: float
    from_cm: float = 0.0
    order = 0

    def between(self) -> Iterator["Coarser"]:
        """Rounding to the values between the multiples, at most `PHASES` - 1 of them."""
        phases = min(int(self.step_cm / self.resolution_cm), PHASES)
        return (replace(self, from_cm=self.step_cm * k / phases) for k in range(1, phases))

    def arrives(self, code: Array) -> Array:
        return self._arrivals[np.clip(self._place(code) - 1, 0, self._arrivals.size - 1)]

    def origins(self, first: Array, last: Array) -> Origins:
        above = self._above[self._place(first - self.resolution_cm)], self._above[self._place(last)]
        return [(self._code(above[0]), self._code(above[1] - 1))]

    def _place(self, code: Array) -> Indices:
        """Number of each code, from 0 for one below the shortest."""
        place = np.rint((code - self.minimum_cm) / self.resolution_cm) + 1.0
        return np.clip(place, 0, self._arrivals.size).astype(np.intp)

    def _code(self, number: Indices) -> Array:
        """The sensor's code of this number, from 0 for the shortest."""
        code: Array = on_grid(self.minimum_cm + self.resolution_cm * number, self.resolution_cm)
        return code

    @cached_property
    def _above(self) -> Indices:
        """Number of the first of the sensor's codes that is received as more than each code of `_place`."""
        return np.searchsorted(self._arrivals, self._code(np.arange(-1, self._arrivals.size)), "right")

    @cached_property
    def _arrivals(self) -> Array:
        """Received code for each of the sensor's codes; never decreasing."""
        code = self._code(np.arange(round((self.maximum_cm - self.minimum_cm) / self.resolution_cm) + 1))
        steps = np.floor((code - self.from_cm) / self.step_cm + 0.5)
        arrivals = on_grid(steps * self.step_cm + self.from_cm, self.resolution_cm)
        arrivals = np.clip(arrivals, self.minimum_cm, self.maximum_cm)
        arrivals[[0, -1]] = code[[0, -1]]
        return np.asarray(arrivals)


@dataclass(frozen=True)
class Saturated:
    """Limited to eight bits: at most 255."""

    order = 1

    def arrives(self, code: Array) -> Array:
        return np.minimum(code, 255.0)

    def origins(self, first: Array, last: Array) -> Origins:
        return [(np.where(first > 255.0, np.inf, first), np.where(last >= 255.0, np.inf, last))]


@dataclass(frozen=True)
class LostHighByte:
    """Only the low byte is received: modulo 256."""

    order = 2

    def arrives(self, code: Array) -> Array:
        return np.mod(code, 256.0)

    def origins(self, first: Array, last: Array) -> Origins:
        first, last = np.maximum(first, 0.0), np.minimum(last, 255.0)
        return [(first + high, np.where(last < first, -1.0, last + high)) for high in (0.0, 256.0, 512.0)]


@dataclass(frozen=True)
class OrEd:
    """High and low byte OR-ed into one: 765 = 0x02FD becomes 0x02 | 0xFD = 255."""

    order = 3

    def arrives(self, code: Array) -> Array:
        whole = code.astype(np.int64)
        return ((whole >> 8) | (whole & 0xFF)).astype(np.float64)

    def origins(self, first: Array, last: Array) -> Origins:
        if not (first == last).all():
            return self._origins_below(np.minimum(last + 1.0, 256.0))
        ranges = []
        for high in (0, 1, 2):
            arrives = (last >= 0.0) & (last <= 255.0) & ((np.clip(last, 0.0, 255.0).astype(np.int64) & high) == high)
            for low_byte in (last, last - high) if high else (last,):
                code = 256.0 * high + low_byte
                ranges.append((code, np.where(arrives, code, -1.0)))
        return ranges

    def _origins_below(self, arrived: Array) -> Origins:
        """Sent codes that are received as less than ``arrived``."""
        ranges = [(np.zeros_like(arrived), arrived - 1.0)]
        for high, block in ((1, 2.0), (2, 4.0)):
            # Low bytes in whole blocks of 2 or 4 stay within their block.
            ranges.append((np.full_like(arrived, 256.0 * high), 256.0 * high + np.floor(arrived / block) * block - 1.0))
        # Of a block that begins at 4 j, the codes 4 j and 4 j + 2 become 4 j + 2, which is less than 4 j + 3.
        for before in (3.0, 1.0):
            code = 512.0 + arrived - before
            ranges.append((code, np.where(np.mod(arrived, 4.0) == 3.0, code, -1.0)))
        return ranges


@dataclass(frozen=True)
class ClockFault:
    """Bit 15 set."""

    order = 4

    def arrives(self, code: Array) -> Array:
        return code + CLOCK_FAULT_BIT

    def origins(self, first: Array, last: Array) -> Origins:
        return [(first - CLOCK_FAULT_BIT, last - CLOCK_FAULT_BIT)]
