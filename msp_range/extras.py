"""Optional packages (pip's extras), and the error message of commands that need one."""

import sys
from importlib.util import find_spec
from shlex import quote

from msp_range.yaml_file import ConfigError

EXTRAS = {
    "kalman": ("filterpy", "scipy"),
    "sim": ("matplotlib", "scipy", "threadpoolctl"),
    "lab": ("jinja2", "matplotlib", "scipy", "threadpoolctl"),
    "fleet": ("bokeh", "distributed"),
    "logs": ("pyarrow", "pyulog", "rosbags"),
    "web": ("prometheus_client", "segno", "websockets"),
}
"""Packages of each extra; a test compares it with pyproject.toml."""


DRAWING = "matplotlib"
"""The package for drawing, without which simulated flights can still be flown."""


def missing(extra: str, but: str = "") -> str | None:
    """Missing packages of an extra with the command that installs them; None if all are there, ``but`` one.

    The command names the environment's own Python: on a vehicle, and in a clone before its environment is activated,
    ``pip`` is that of the system.

    Examples
    --------
    >>> missing("lab")
    """
    absent = [name for name in EXTRAS[extra] if name != but and find_spec(name) is None]
    return f"{', '.join(absent)}: {quote(sys.executable)} -m pip install 'msp-range[{extra}]'" if absent else None


def require(extra: str, command: str, but: str = "") -> None:
    """Refuse a command before it starts if a required extra is not installed.

    Parameters
    ----------
    extra
        A key of `EXTRAS`.
    command
        The command, such as ``msp-sim fly``.
    but
        A package of the extra that the command does not require.

    Raises
    ------
    ConfigError
        A package is missing.
    """
    if (absent := missing(extra, but)) is not None:
        raise ConfigError(f"{command} needs {absent}")
