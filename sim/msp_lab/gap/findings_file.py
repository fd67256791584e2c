"""``gap.json``: what the gap workflow found, written to a folder and read from one."""

import json
from functools import cache
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from msp_lab.gap.findings import GapFindings
from msp_range.input_file import read_text
from msp_range.yaml_file import ConfigError, writing

NUMBERS = "gap.json"
LARGEST_BYTES = 64 * 2**20
"""A larger file was not written by the gap workflow, whose files have 0.1 to 1 MB."""


@cache
def findings_form() -> TypeAdapter[GapFindings]:
    """Reads and writes findings."""
    return TypeAdapter(GapFindings)


def as_json(findings: GapFindings) -> str:
    """Findings as JSON, numbers to seven digits; what is not finite is null.

    Examples
    --------
    >>> found = GapFindings("nothing missing", rows=2000, runs=10)
    >>> from_json(as_json(found)) == found
    True
    """
    content = json.loads(findings_form().dump_json(findings), parse_float=lambda number: float(f"{float(number):.7g}"))
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def from_json(text: str) -> GapFindings:
    """`as_json` backwards.

    Raises
    ------
    ValueError
        It is no such JSON.
    """
    try:
        return findings_form().validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ValueError(f"not written by msp-lab gap: {place + ': ' if place else ''}{first['msg']}") from None


def write_findings(findings: GapFindings, folder: Path) -> Path:
    """Write ``gap.json`` into a folder; an older one is replaced.

    Raises
    ------
    ConfigError
        It cannot be written.
    """
    path = folder / NUMBERS
    with writing(path):
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(as_json(findings), encoding="utf-8")
    return path


def read_findings(folder: Path) -> GapFindings:
    """Read ``gap.json`` of a folder.

    Raises
    ------
    ConfigError
        There is none, or it is none.
    """
    path = folder / NUMBERS
    try:
        return from_json(read_text(path, LARGEST_BYTES))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; 'msp-lab compare' or 'msp-lab gap' makes it") from None
    except NotADirectoryError:
        raise ConfigError(f"{folder}: is a file; expected the folder that 'msp-lab gap' wrote (--out)") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
