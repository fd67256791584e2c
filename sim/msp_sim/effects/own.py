"""Effects from outside the package: from installed packages by entry points, and from a Python file named by the user.

Both are added to the catalogue and then are equal to those in it: model files may name them, and the gap workflow tests
them. A file holds one or more `Effect` objects at its top level; an entry point of the group `GROUP` is one::

    [project.entry-points."msp_sim.effects"]
    my_effect = "my_package.my_effect:MY_EFFECT"
"""

import sys
import traceback
from collections.abc import Sequence
from functools import cache
from importlib.metadata import EntryPoint
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from msp_range.plugins import installed, load_entry
from msp_range.yaml_file import ConfigError
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import Effect

GROUP = "msp_sim.effects"
"""Group of the entry points of installed packages with effects."""

_SOURCES: dict[str, str] = {}
"""Source of each effect that was added."""


def find_effect(name: str) -> Effect | None:
    """Find an effect by name in the catalogue or in an installed package; None if there is none.

    Raises
    ------
    ConfigError
        The package with the effect cannot be used.
    """
    if name not in CATALOGUE and (entry := installed(GROUP).get(name)) is not None:
        _add_installed(entry)
    return CATALOGUE.get(name)


def add_own_effects(files: Sequence[Path]) -> None:
    """Add the effects of all installed packages and of these files to the catalogue.

    Raises
    ------
    ConfigError
        A package or a file cannot be used, or an effect has the name of another one.
    """
    for entry in installed(GROUP).values():
        _add_installed(entry)
    for path in files:
        for effect in effects_of_file(path):
            _add(effect, str(path))


@cache
def add_own_effects_once(files: tuple[Path, ...]) -> None:
    """As `add_own_effects`, once in each process: for functions that a worker calls for many items."""
    add_own_effects(files)


def effects_of_file(path: Path) -> list[Effect]:
    """The effects at the top level of a Python file.

    Raises
    ------
    ConfigError
        There is no such file, it cannot be run, or it contains no effect.
    """
    found = {value.name: value for value in vars(_run(path)).values() if isinstance(value, Effect)}
    # Effects that the file imports from the catalogue are not its own.
    own = [effect for effect in found.values() if effect is not CATALOGUE.get(effect.name)]
    if not own:
        raise ConfigError(f"{path}: found no effect; expected an msp_sim.effects.base.Effect at the top level")
    return own


def _run(path: Path) -> ModuleType:
    if not path.is_file():
        raise ConfigError(f"{path}: no such file")
    spec = spec_from_file_location(f"own_effects_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{path}: expected a Python file, whose name ends in .py")
    module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # Any exception of a user's file is an error in that file.
        lines = [frame.lineno for frame in traceback.extract_tb(sys.exc_info()[2]) if frame.filename == str(path)]
        line = error.lineno if isinstance(error, SyntaxError) else lines[-1] if lines else None
        place = f"{path}:{line}" if line is not None else str(path)
        raise ConfigError(f"{place}: {type(error).__name__}: {error}") from None
    return module


def _add_installed(entry: EntryPoint) -> None:
    _add(load_entry(entry, "effect", Effect), entry.value)


def _add(effect: Effect, source: str) -> None:
    if effect.name in CATALOGUE and _SOURCES.get(effect.name) != source:
        known = _SOURCES.get(effect.name, "the catalogue")
        raise ConfigError(f"{source}: the effect {effect.name!r} has the name of one of {known}; give it another")
    _SOURCES[effect.name] = source
    CATALOGUE[effect.name] = effect
