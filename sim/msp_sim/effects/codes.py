"""Faults of the transmission: each turns the code of a reading into another one.

A fault affects a share of the readings. The probability of a received code is the sum over the codes that the fault
turns into it, so each fault can list those (`CodeFault.origins`).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]
CLOCK_FAULT = 0x8000
"""Bit 15, which reads as one if the master samples while the sensor still stretches the clock."""


class CodeFault(Protocol):
    """One kind of fault.

    Attributes
    ----------
    order
        Faults are applied in this order, from the sensor to the master.
    """

    @property
    def order(self) -> int: ...

    def arrives(self, code: _Array) -> _Array:
        """The code that is received for each sent code."""

    def origins(self, first: _Array, last: _Array) -> list[tuple[_Array, _Array]]:
        """Ranges (first, last) of sent codes that are received as codes from first to last; empty if last < first.

        A fault that is not monotone supports single codes (first == last) and all codes up to one (first = -inf).
        """


@dataclass(frozen=True)
class Coarser:
    """Rounded to multiples of a step, then to whole centimetres; the sensor's limits are unchanged."""

    step_cm: float
    minimum_cm: int
    maximum_cm: int
    order = 0

    def arrives(self, code: _Array) -> _Array:
        return self._arrivals[np.clip(code - self.minimum_cm, 0, self._arrivals.size - 1).astype(np.int64)]

    def origins(self, first: _Array, last: _Array) -> list[tuple[_Array, _Array]]:
        return [(self._first_above[self._place(first - 1.0)], self._first_above[self._place(last)] - 1.0)]

    def _place(self, code: _Array) -> NDArray[np.intp]:
        return np.clip(code - (self.minimum_cm - 1.0), 0, self._first_above.size - 1).astype(np.intp)

    @cached_property
    def _first_above(self) -> _Array:
        """First of the sensor's codes that is received as more than each code, from one below the shortest."""
        code = np.arange(self.minimum_cm - 1.0, self.maximum_cm + 1.0)
        return self.minimum_cm + np.searchsorted(self._arrivals, code, "right").astype(np.float64)

    @cached_property
    def _arrivals(self) -> _Array:
        """Received code for each of the sensor's codes; never decreasing."""
        code = np.arange(self.minimum_cm, self.maximum_cm + 1.0)
        arrivals = np.rint(np.floor(code / self.step_cm + 0.5) * self.step_cm)
        arrivals = np.clip(arrivals, self.minimum_cm, self.maximum_cm)
        arrivals[[0, -1]] = code[[0, -1]]
        return arrivals


@dataclass(frozen=True)
class Saturated:
    """Limited to eight bits: at most 255."""

    order = 1

    def arrives(self, code: _Array) -> _Array:
        return np.minimum(code, 255.0)

    def origins(self, first: _Array, last: _Array) -> list[tuple[_Array, _Array]]:
        return [(np.where(first > 255.0, np.inf, first), np.where(last >= 255.0, np.inf, last))]


@dataclass(frozen=True)
class LostHighByte:
    """Only the low byte is received: modulo 256."""

    order = 2

    def arrives(self, code: _Array) -> _Array:
        return np.mod(code, 256.0)

    def origins(self, first: _Array, last: _Array) -> list[tuple[_Array, _Array]]:
        first, last = np.maximum(first, 0.0), np.minimum(last, 255.0)
        return [(first + high, np.where(last < first, -1.0, last + high)) for high in (0.0, 256.0, 512.0)]


@dataclass(frozen=True)
class OrEd:
    """High and low byte OR-ed into one: 765 = 0x02FD becomes 0x02 | 0xFD = 255."""

    order = 3

    def arrives(self, code: _Array) -> _Array:
        whole = code.astype(np.int64)
        return ((whole >> 8) | (whole & 0xFF)).astype(np.float64)

    def origins(self, first: _Array, last: _Array) -> list[tuple[_Array, _Array]]:
        if not (first == last).all():
            return self._origins_below(np.minimum(last + 1.0, 256.0))
        ranges = []
        for high in (0, 1, 2):
            arrives = (last >= 0.0) & (last <= 255.0) & ((np.clip(last, 0.0, 255.0).astype(np.int64) & high) == high)
            for low_byte in (last, last - high) if high else (last,):
                code = 256.0 * high + low_byte
                ranges.append((code, np.where(arrives, code, -1.0)))
        return ranges

    def _origins_below(self, arrived: _Array) -> list[tuple[_Array, _Array]]:
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

    def arrives(self, code: _Array) -> _Array:
        return code + CLOCK_FAULT

    def origins(self, first: _Array, last: _Array) -> list[tuple[_Array, _Array]]:
        return [(first - CLOCK_FAULT, last - CLOCK_FAULT)]
