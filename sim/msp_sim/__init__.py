"""Loopback simulator of msp_range. Imports nothing, so that the device needs no package.

For programs and notebooks: `simulate_flight`, imported when it is first used.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from msp_sim.flight.simulate import simulate_flight

__all__ = ["simulate_flight"]


def __getattr__(name: str) -> Any:
    if name == "simulate_flight":
        from msp_sim.flight.simulate import simulate_flight

        return simulate_flight
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
