"""Laboratory of msp_range: what is learnt from readings, measured or simulated.

For programs and notebooks: `read_readings`, `characterise` and `find_gap`, imported when they are first used.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from msp_lab.characterise.from_files import characterise
    from msp_lab.gap.from_files import find_gap
    from msp_lab.readings.from_files import read_readings

__all__ = ["characterise", "find_gap", "read_readings"]


def __getattr__(name: str) -> Any:
    if name == "read_readings":
        from msp_lab.readings.from_files import read_readings

        return read_readings
    if name == "characterise":
        from msp_lab.characterise.from_files import characterise

        return characterise
    if name == "find_gap":
        from msp_lab.gap.from_files import find_gap

        return find_gap
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
