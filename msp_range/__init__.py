"""MAVLink companion-computer bridge for ultrasonic range finders: what flies.

For programs and notebooks: `load_airframe` and `ReadingModel`, imported when they are first used.
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.9.0"

if TYPE_CHECKING:
    from msp_range.config import load_airframe
    from msp_range.reading_model.mixture import ReadingModel

__all__ = ["ReadingModel", "load_airframe"]


def __getattr__(name: str) -> Any:
    if name == "load_airframe":
        from msp_range.config import load_airframe

        return load_airframe
    if name == "ReadingModel":
        from msp_range.reading_model.mixture import ReadingModel

        return ReadingModel
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
