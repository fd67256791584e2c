"""Laboratory of msp_range: what is learnt from readings, measured or simulated.

For programs and notebooks: `read_readings`, `characterise` and `find_gap`, imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from msp_lab.characterise.from_files import characterise
    from msp_lab.gap.steps import find_gap
    from msp_lab.readings.from_files import read_readings

__all__ = ["characterise", "find_gap", "read_readings"]
_MODULES = {
    "characterise": "characterise.from_files",
    "find_gap": "gap.steps",
    "read_readings": "readings.from_files",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
