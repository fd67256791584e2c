"""What is installed only on request: pip's extras, and the line that asks for one before the work begins."""

from importlib.util import find_spec

from msp_range.yaml_file import ConfigError

EXTRAS = {
    "kalman": ("filterpy", "scipy"),
    "sim": ("matplotlib", "scipy"),
    "lab": ("jinja2", "matplotlib", "scipy"),
}
"""Extra -> the packages that it installs; a test holds it against pyproject.toml."""


DRAWING = "matplotlib"
"""What draws: simulated flights do without where it is missing."""


def missing(extra: str, but: str = "") -> str | None:
    """What of an extra is not installed, and how to install it; None where nothing is missing ``but`` one package.

    Examples
    --------
    >>> missing("lab")
    """
    absent = [name for name in EXTRAS[extra] if name != but and find_spec(name) is None]
    return f"{', '.join(absent)}: pip install 'msp-range[{extra}]'" if absent else None


def require(extra: str, command: str, but: str = "") -> None:
    """Refuse a command before its work where an extra that it needs is not installed.

    Parameters
    ----------
    extra
        A key of `EXTRAS`.
    command
        What needs it, such as ``msp-sim fly``.
    but
        A package of it that the command does without.

    Raises
    ------
    ConfigError
        A package is missing.
    """
    if (absent := missing(extra, but)) is not None:
        raise ConfigError(f"{command} needs {absent}")
