"""What all emulated range finders share, seen from the bus, and the faults that real ones show.

It takes bytes written by the master, and answers with the readings of a simulated world. Only the standard library is
used, so that the same device answers in a virtual flight and behind an emulated kernel interface under the system's own
Python. Every time is seconds on the ``now`` clock that the device is given.
"""

import math
import random
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

CLOCK_FAULT_BIT = 0x8000
"""Bit that reads as one in a 16-bit answer that is read too early."""
LARGEST_CODE = 0xFFFF
"""Mask of a 16-bit answer."""


class NotAcknowledged(Exception):
    """Nobody pulled the data line low."""


@dataclass(frozen=True)
class DeviceTiming:
    """How long a sensor ranges, and for how long an address change keeps it busy."""

    ready_s: float
    s_per_cm: float
    """A ranging with an echo takes ``ready_s + s_per_cm * reading_cm`` [s, s/cm]."""
    no_echo_s: float
    """A ranging without an echo takes this long [s], and none takes longer."""
    address_change_s: float = 0.0
    """Time for which an address change keeps the sensor busy [s]."""

    def ranging_s(self, reading_cm: float, no_echo_cm: int) -> float:
        """Time from the ping until the ranging has ended [s]."""
        # A word that is no range, such as one behind a clock fault, takes no longer than the cycle.
        whole_s = self.ready_s + self.s_per_cm * reading_cm
        return self.no_echo_s if reading_cm == no_echo_cm else min(whole_s, self.no_echo_s)


FAULT_KINDS = {
    "clock_fault": "bit 15 reads as one: the master samples while the sensor still stretches the clock",
    "or_ed": "the two bytes are OR-ed into one, a shift lost by the driver: 300 reads 45",
    "saturated": "the reading saturates to eight bits: 300 reads 255",
    "lost_high_byte": "range modulo 256: 300 reads 44",
    "impossible": "the answer is `word`, which no healthy sensor gives",
    "missed_read": "one read of a ranging is not acknowledged, the next one is",
    "stuck": "pings are accepted and the last reading stays",
    "no_echo": "the ranging receives no echo: it takes the whole cycle and reads the code for it",
    "noisy": "ranges scatter about the true one, normally distributed with `spread_cm`",
    "offset": "ranges are off by `offset_cm`",
    "drift": "ranges are off by an error that grows from zero by `rate_cm_s`",
    "constant": "every ranging reads `constant_cm`, whatever is there",
    "previous_ping": "the answer is that of the ranging before: late by one turn",
    "fixed_object": "something on the vehicle is in the beam at `object_cm`, a strap or ice: the nearest echo counts",
    "dust": "dust in the beam: an echo from anywhere between the sensor's shortest range and `dust_cm`, if the nearest",
    "silent": "nothing is acknowledged",
    "power_cycle": "without power from start_s to end_s, then part info until the next ping",
    "locked_up": "the data line is held low: every transfer of the bus times out, until a re-open after end_s",
}
"""Every kind of fault and what it looks like from the master."""

SERIAL_FAULT_KINDS = {
    "half_line": "a line breaks off in its middle",
    "noise": "bytes that the sensor did not send are within a line",
    "garbled_digit": "one bit of a line's first digit is wrong, and nothing shows it: 300 reads 200",
    "wrong_baud": "the port has another rate than the sensor: other bytes arrive, and no end of a line",
    "unplugged": "the serial adapter is not there, and comes back under the same name",
}
"""The same for sensors on a serial port, which show most of the others too."""

ALWAYS_HAPPEN = frozenset({"power_cycle", "locked_up"})
"""Faults with a probability of 1."""
DRAWN = frozenset({"noisy", "fixed_object", "dust"})
"""Faults that draw an error for every ping, even with a probability of 1."""


@dataclass(frozen=True)
class Fault:
    """A fault that lasts from ``start_s`` up to ``end_s``.

    Raises
    ------
    ValueError
        An unknown kind, a window that does not last, a word of more than 16 bits, a spread, range or period that is not
        positive, or a jitter or swing below zero.
    """

    kind: str
    """One of `FAULT_KINDS` or `SERIAL_FAULT_KINDS`."""
    start_s: float
    end_s: float
    """When it lasts [s on the device's clock]. A power cycle or a lock-up may have no length."""
    probability: float = 1.0
    """Probability that one opportunity shows the fault: one read for the kinds that change the answer, one ping for
    "stuck", "previous_ping", "missed_read" and those that change the ranging ("no_echo", "noisy", "offset", "drift",
    "constant", "fixed_object", "dust"), one transfer for "silent". A power cycle and a lock-up always happen."""
    word: int = 1000
    """The 16-bit answer of the kind "impossible"."""
    spread_cm: float = 100.0
    """Standard deviation of the error of the kind "noisy" [cm]."""
    offset_cm: float = 100.0
    """Error of the kind "offset" [cm]."""
    rate_cm_s: float = 2.0
    """How fast the error of the kind "drift" grows [cm/s]; negative: ranges become too short."""
    constant_cm: int = 100
    """Reading of the kind "constant" [cm]."""
    object_cm: float = 40.0
    jitter_cm: float = 0.5
    """Mean range of the object of the kind "fixed_object", and standard deviation from ping to ping [cm]."""
    swing_cm: float = 0.0
    swing_period_s: float = 2.0
    """The object swings about its mean range with this amplitude [cm] and period [s]."""
    dust_cm: float = 100.0
    """How far down the dust of the kind "dust" is [cm]."""

    def __post_init__(self) -> None:
        if self.kind not in (known := FAULT_KINDS | SERIAL_FAULT_KINDS):
            raise ValueError(f"fault kind {self.kind!r}: expected one of {', '.join(known)}")
        if self.end_s < self.start_s or (self.end_s == self.start_s and self.kind not in ALWAYS_HAPPEN):
            raise ValueError(f"fault {self.kind}: end_s {self.end_s}: expected a time after start_s {self.start_s}")
        if not 0.0 < self.probability <= 1.0 or (self.kind in ALWAYS_HAPPEN and self.probability != 1.0):
            expected = "1, it always happens" if self.kind in ALWAYS_HAPPEN else "more than 0 and at most 1"
            raise ValueError(f"fault {self.kind}: probability {self.probability}: expected {expected}")
        if not 0 <= self.word <= LARGEST_CODE:
            raise ValueError(f"fault {self.kind}: word 0x{self.word:x}: expected 16 bits")
        for name in ("spread_cm", "constant_cm", "object_cm", "swing_period_s", "dust_cm"):
            if not getattr(self, name) > 0:
                raise ValueError(f"fault {self.kind}: {name} {getattr(self, name)}: expected more than 0")
        for name in ("jitter_cm", "swing_cm"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"fault {self.kind}: {name} {getattr(self, name)}: expected 0 or more")


class RangeFinder(ABC):
    """What every emulated range finder has: an address, a world that it ranges in, and faults; the base of each kind.

    Parameters
    ----------
    address
        7-bit address, or serial port.
    now
        The time [s].
    echo
        Called exactly once a ping, with its time [s]; returns the reading [cm], which is rounded to the sensor's steps;
        `no_echo_cm` where there was no echo. One below the sensor's shortest is a word with a lost byte.
    timing
        How long it is busy; None: as its kind is.
    faults
        What is wrong with it, and when.
    chance
        Draws for faults with a probability below one and for the errors of the kinds in `DRAWN`.

    Attributes
    ----------
    address : int or str
        Address, as it is now.
    pings : int
        Range commands accepted so far.
    fault_kinds : frozenset
        Kinds of fault that this kind of sensor can show.

    Raises
    ------
    ValueError
        A fault is drawn and there is no ``chance``, or the sensor cannot show it.
    """

    per_cm: int = 1
    """Steps of its readings in a centimetre."""
    minimum_cm: int
    no_echo_cm: int
    """Shortest reading, and the one of no echo [cm]."""
    default_timing: DeviceTiming
    """Timing of its kind."""
    no_echo_codes: frozenset[int] = frozenset()
    """Readings that may as well say that there was no echo [cm]: errors of the ranging leave them alone."""
    fault_kinds = frozenset(FAULT_KINDS)
    also_at: int | None = None
    """Its second address, if it has one."""

    def __init__(
        self,
        address: int | str,
        now: Callable[[], float],
        echo: Callable[[float], float],
        timing: DeviceTiming | None = None,
        faults: Sequence[Fault] = (),
        chance: random.Random | None = None,
    ) -> None:
        if chance is None and any(fault.probability < 1.0 or fault.kind in DRAWN for fault in faults):
            raise ValueError("a fault has a probability below one, or random errors: pass a random.Random as chance")
        for fault in faults:
            self.check_fault(fault)
        self.address = address
        self.faults = tuple(faults)
        self.pings = 0
        self._now = now
        self._echo = echo
        self._timing = timing or self.default_timing
        # Where nothing is drawn, none is needed.
        self._chance = chance or random.Random(0)
        self._power_cycles = sorted((f for f in faults if f.kind == "power_cycle"), key=lambda fault: fault.start_s)
        self.power_cycle()

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Take ``data``; raises NotAcknowledged where it does not answer."""

    @abstractmethod
    def read(self, count: int) -> bytes:
        """Return ``count`` bytes; raises NotAcknowledged where it does not answer."""

    @classmethod
    def check_fault(cls, fault: Fault) -> None:
        """Check that this kind of sensor can show a fault.

        Raises
        ------
        ValueError
            It cannot, or the word of the kind "impossible" is one that a healthy sensor gives.
        """
        if fault.kind not in cls.fault_kinds:
            raise ValueError(f"kind: found {fault.kind!r}; expected one of {', '.join(sorted(cls.fault_kinds))}")
        # With bit 15 set, a range is one behind a clock fault where the sensor shows those: that kind stands for it.
        value = fault.word & ~CLOCK_FAULT_BIT if "clock_fault" in cls.fault_kinds else fault.word
        if fault.kind == "impossible" and cls.minimum_cm <= value <= cls.no_echo_cm:
            raise ValueError(
                f"word: found 0x{fault.word:x}, which is a range; expected a word that is none, such as 0xffff"
            )

    def power_cycle(self) -> None:
        """Lose the last ranging and whatever was going on."""
        self._answer = b""
        self._ranged = False
        self._ranging = b""
        self._busy_until_s = float("-inf")
        self._may_miss_read = True

    @property
    def busy_until_s(self) -> float:
        """Until when it ranges or does something else that keeps it from answering [s]."""
        return self._busy_until_s

    def _with_power(self) -> float:
        """Return the time [s] of a transfer that no fault keeps from the sensor."""
        now_s = self._now()
        if self.faults:
            while self._power_cycles and now_s >= self._power_cycles[0].start_s:
                if now_s < self._power_cycles[0].end_s:
                    raise NotAcknowledged
                self._power_cycles.pop(0)
                self.power_cycle()
            if self._strikes("silent", now_s):
                raise NotAcknowledged
        return now_s

    def _ping(self, now_s: float) -> None:
        reading_cm = self._in_steps(self._echo(now_s))
        if not 0 <= reading_cm * self.per_cm <= LARGEST_CODE:
            raise ValueError(f"echo returned {reading_cm} cm: expected what two bytes hold, 0 to {LARGEST_CODE}")
        if self.faults:
            reading_cm = self._misrange(reading_cm, now_s)
        self.pings += 1
        self._busy_until_s = now_s + self._timing.ranging_s(reading_cm, self.no_echo_cm)
        self._may_miss_read = True
        before, self._ranging = self._ranging, round(reading_cm * self.per_cm).to_bytes(2, "big")
        if not (self._ranged and self.faults and self._strikes("stuck", now_s)):
            is_late = self._ranged and self.faults and self._strikes("previous_ping", now_s)
            self._answer = before if is_late else self._ranging
            self._ranged = True

    def _read_answer(self, now_s: float) -> bytes:
        """Return the two bytes of the last ranging, with what is wrong with them."""
        answer = self._answer
        if self.faults:
            may_miss_read, self._may_miss_read = self._may_miss_read, False
            if may_miss_read and self._strikes("missed_read", now_s):
                raise NotAcknowledged
            answer = self._corrupt(answer, now_s)
        return answer

    def _strikes(self, kind: str, now_s: float) -> bool:
        return any(fault.kind == kind and self._fault_strikes(fault, now_s) for fault in self.faults)

    def _fault_strikes(self, fault: Fault, now_s: float) -> bool:
        if not fault.start_s <= now_s < fault.end_s:
            return False
        return fault.probability == 1.0 or self._chance.random() < fault.probability

    def _misrange(self, reading_cm: float, now_s: float) -> float:
        """Return what is ranged instead, each fault on top of those before it in the list; busy times follow it."""
        for fault in self.faults:
            if fault.kind not in _RANGED or not self._fault_strikes(fault, now_s):
                continue
            ranged_cm = _ranged_cm(fault, now_s, self._chance, self.minimum_cm)
            if fault.kind not in _ERRORS:
                nearest_cm = reading_cm if fault.kind in _IN_THE_BEAM else self.no_echo_cm
                reading_cm = min(nearest_cm, self._within_limits(ranged_cm))
            # No echo stays no echo.
            elif reading_cm not in (self.no_echo_cm, *self.no_echo_codes):
                reading_cm = self._within_limits(reading_cm + ranged_cm)
        return reading_cm

    def _within_limits(self, range_cm: float) -> float:
        """What the sensor answers for a range [cm]."""
        return self._in_steps(min(max(range_cm, self.minimum_cm), self.no_echo_cm))

    def _in_steps(self, reading_cm: float) -> float:
        return round(reading_cm * self.per_cm) / self.per_cm

    def _corrupt(self, answer: bytes, now_s: float) -> bytes:
        """Return the answer as the master sees it, each fault on top of those before it in the list."""
        word = int.from_bytes(answer, "big")
        for fault in self.faults:
            if fault.kind in _CORRUPTIONS and self._fault_strikes(fault, now_s):
                word = _CORRUPTIONS[fault.kind](word, fault)
        return word.to_bytes(2, "big")


_CORRUPTIONS: dict[str, Callable[[int, Fault], int]] = {
    "clock_fault": lambda word, fault: word | CLOCK_FAULT_BIT,
    "or_ed": lambda word, fault: word >> 8 | word & 0xFF,
    "saturated": lambda word, fault: min(word, 0xFF),
    "lost_high_byte": lambda word, fault: word & 0xFF,
    "impossible": lambda word, fault: fault.word,
}


_ERRORS = ("noisy", "offset", "drift")
"""Faults that add an error to a range."""
_IN_THE_BEAM = ("fixed_object", "dust")
"""Faults that put something into the beam: the sensor reads the nearest."""
_RANGED = (*_ERRORS, *_IN_THE_BEAM, "no_echo", "constant")
"""Faults that change what is ranged."""


def _ranged_cm(fault: Fault, now_s: float, chance: random.Random, minimum_cm: int) -> float:
    """What one of the faults `_RANGED` ranges instead [cm], or for `_ERRORS` what it adds to a range."""
    match fault.kind:
        case "noisy":
            return chance.gauss(0.0, fault.spread_cm)
        case "offset":
            return fault.offset_cm
        case "drift":
            return fault.rate_cm_s * (now_s - fault.start_s)
        case "fixed_object":
            swing_cm = fault.swing_cm * math.sin(2 * math.pi * now_s / fault.swing_period_s)
            return fault.object_cm + swing_cm + chance.gauss(0.0, fault.jitter_cm)
        case "dust":
            return chance.uniform(minimum_cm, max(fault.dust_cm, minimum_cm))
        case "constant":
            return fault.constant_cm
    return math.inf
