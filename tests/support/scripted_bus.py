"""A bus that plays a script: transfers in order, each with its answer or errno, none missing and none left over."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

from msp_range.bus.base import Address, BusError
from msp_range.clock import Clock


@dataclass(frozen=True)
class Expected:
    """One transfer: what the driver asks, and what comes of it."""

    verb: str
    address: int = 0
    written: bytes = b""
    answer: bytes = b""
    errno: int = 0
    at_s: float | None = None
    """when it must come on the clock [s]; None: whenever"""
    takes_s: float = 0.0
    """how long it holds the caller [s]"""


def write(address: int, data: bytes, *, errno: int = 0, at_s: float | None = None, takes_s: float = 0.0) -> Expected:
    """The driver writes exactly ``data``."""
    return Expected("write", address, written=data, errno=errno, at_s=at_s, takes_s=takes_s)


def read(
    address: int, answer: bytes = b"??", *, errno: int = 0, at_s: float | None = None, takes_s: float = 0.0
) -> Expected:
    """The driver reads exactly as many bytes as ``answer`` has."""
    return Expected("read", address, answer=answer, errno=errno, at_s=at_s, takes_s=takes_s)


def reopen(*, errno: int = 0, at_s: float | None = None, takes_s: float = 0.0) -> Expected:
    """The driver opens the bus again."""
    return Expected("reopen", errno=errno, at_s=at_s, takes_s=takes_s)


class ScriptedBus:
    """A Bus that fails the test at the first transfer that is not the next of its script."""

    def __init__(self, clock: Clock, script: tuple[Expected, ...]) -> None:
        self._clock = clock
        self._script = script
        self.done = 0

    def write(self, address: Address, data: bytes) -> None:
        self._next("write", address, written=data)

    def read(self, address: Address, count: int) -> bytes:
        answer = self._next("read", address, count=count).answer
        assert len(answer) == count
        return answer

    def busy_s(self, address: Address) -> None: ...

    def reopen(self) -> None:
        self._next("reopen", 0)

    def close(self) -> None:
        pytest.fail("the bus was closed")

    def _next(self, verb: str, address: Address, written: bytes = b"", count: int | None = None) -> Expected:
        now_s = self._clock.now()
        asked = f"{verb} 0x{address:02x} {written.hex() if count is None else count} at {now_s:.4f} s"
        if self.done == len(self._script):
            pytest.fail(f"after the end of the script: {asked}")
        expected = self._script[self.done]
        self.done += 1
        if (verb, address, written) != (expected.verb, expected.address, expected.written):
            pytest.fail(f"transfer {self.done} of the script: {asked}; expected {expected}")
        if expected.at_s is not None and abs(now_s - expected.at_s) > 1e-9:
            pytest.fail(f"transfer {self.done} of the script: {asked}; expected at {expected.at_s} s")
        if expected.takes_s:
            self._clock.sleep_until(now_s + expected.takes_s)
        if expected.errno:
            raise BusError(expected.errno, verb, address)
        return expected


@contextmanager
def scripted_bus(clock: Clock, *script: Expected) -> Iterator[ScriptedBus]:
    """A bus with a script, of which nothing may be left over."""
    bus = ScriptedBus(clock, script)
    yield bus
    assert bus.done == len(script), f"not asked for: {script[bus.done :]}"
