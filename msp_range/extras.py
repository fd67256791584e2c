"""Optional packages (pip's extras), the error message of what needs one, and `msp-range extras`, which installs them.

install.sh and the Debian package put a lock file, with the hashes of what was tested, into the environment for each
extra that an airframe may need. An environment without one is a clone's or a wheel's, and pip's.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path
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

    On a vehicle that is `install`. Elsewhere it names the environment's own Python: in a clone before its environment
    is activated, ``pip`` is that of the system.

    Examples
    --------
    >>> missing("lab")
    """
    absent = [name for name in EXTRAS[extra] if name != but and find_spec(name) is None]
    if not absent:
        return None
    by_pip = f"{quote(sys.executable)} -m pip install 'msp-range[{extra}]'"
    return f"{', '.join(absent)}: {f'sudo msp-range extras {extra}' if _lock_of(extra).exists() else by_pip}"


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


def install(extra: str) -> None:
    """Install an extra into the environment of a vehicle, in the versions of its lock file, each checked by its hash.

    Parameters
    ----------
    extra
        A key of `EXTRAS`.

    Raises
    ------
    ConfigError
        There is no such extra or no lock file of it, this user may not write there, or pip fails; it has printed why.
    """
    lock = _lock_of(extra)
    if extra not in EXTRAS or not lock.exists():
        known = ", ".join(name for name in EXTRAS if _lock_of(name).exists())
        where = (
            f"those of this installation are {known}" if known else "only install.sh and the Debian package have any"
        )
        raise ConfigError(f"extras: found {extra}; {where}")
    if not os.access(lock.parent, os.W_OK):
        raise ConfigError(f"{lock.parent}: cannot be written; with sudo, then again")
    import subprocess  # which the bridge does not need, and imports this module

    # As install.sh does it. In the folder wheels of the Debian package, those that somebody puts there are found, too.
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "install", "--no-cache-dir")
    checked = ("--no-deps", "--require-hashes", "--only-binary=:all:", f"--find-links={lock.parents[1] / 'wheels'}")
    if subprocess.run([*pip, *checked, f"--requirement={lock}"], umask=0o022).returncode != 0:
        raise ConfigError(f"extras: {extra} was not installed (above); it needs a network")


def _lock_of(extra: str) -> Path:
    return Path(sys.prefix) / f"requirements-{extra}.lock"
