"""Files of parameters as MAVProxy, Mission Planner and QGroundControl's ArduPilot page read them: NAME,VALUE lines.

Comments have lines of their own: MAVProxy does not take them behind a value.
"""

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path

from msp_range.params.settings import Setting
from msp_range.yaml_file import ConfigError, read_config

WIDTH = 100


def text_of(value: float) -> str:
    """A value as files and tables show it.

    Examples
    --------
    >>> text_of(10.0), text_of(0.19), text_of(0.1899999976158142)
    ('10', '0.19', '0.19')
    """
    return f"{value:.7g}"


def parm_text(heading: Iterable[str], settings: Sequence[Setting]) -> str:
    """The content of a file, with each parameter's reason and source above it."""
    lines = [
        line for each in heading for line in textwrap.wrap(each, WIDTH, initial_indent="# ", subsequent_indent="# ")
    ]
    for each in settings:
        lines += ["", f"# {each.reason} ({each.source})", f"{each.name},{text_of(each.value)}"]
    return "\n".join(lines) + "\n"


def read_parm(path: Path) -> dict[str, float]:
    """Names and values of a file.

    Raises
    ------
    ConfigError
        It cannot be read, or a line is no parameter.
    """
    values = {}
    for number, line in enumerate(read_config(path).splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            name, value = words
            values[name] = float(value)
        except ValueError:
            raise ConfigError(f"{path}:{number}: found {line!r}; expected NAME,VALUE") from None
    return values
