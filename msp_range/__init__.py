"""MAVLink companion-computer bridge for ultrasonic range finders: what flies.

For programs and notebooks: `load_airframe`, `ReadingModel` and `UserError`, imported when they are first used.
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.9.0"

if TYPE_CHECKING:
    from msp_range.config import load_airframe
    from msp_range.errors import UserError
    from msp_range.reading_model.mixture import ReadingModel

__all__ = ["ReadingModel", "UserError", "load_airframe"]
_MODULES = {"ReadingModel": "reading_model.mixture", "UserError": "errors", "load_airframe": "config"}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
