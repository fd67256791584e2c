"""From readings to a sensor model: analyses of readings at known ranges, and what they found.

``msp_lab.characterise`` is also the function of that name for programs and notebooks, `from_files.characterise`:
importing one of this package's modules binds the package in its place, so the package can be called like it.
"""

import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    def __call__(self, *arguments: Any, **options: Any) -> dict[str, Any]:
        from msp_lab.characterise.from_files import characterise

        return characterise(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
