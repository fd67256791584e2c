"""What docs/sitl.md and the systemd unit say, for tests that fly with exactly that."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def parameters(section: str) -> dict[str, str]:
    """Parameters in the blocks of a section of docs/sitl.md: lines `NAME value` or `export PX4_PARAM_NAME=value`."""
    lines = re.findall(
        r"^    (?:export PX4_PARAM_)?([A-Z0-9]+_[A-Z0-9_]+)[= ] *(-?[0-9.]+)(?: .*)?$", _text(section), re.M
    )
    assert lines, f"docs/sitl.md: no parameters in section {section!r}"
    return dict(lines)


def sitl_command(section: str, link: str) -> list[str]:
    """The `msp-sim sitl` command of a section of docs/sitl.md, its files as absolute paths and with another link."""
    (line,) = re.findall(r"^    msp-sim (sitl .*)$", _text(section), re.M)
    words = [str(ROOT / word) if word.startswith("configs/") else word for word in line.split()]
    words[words.index("--link") + 1] = link
    return words


def sitl_link(section: str) -> str:
    """Where that command connects to."""
    (link,) = re.findall(r"^    msp-sim sitl .*--link (\S+)", _text(section), re.M)
    return str(link)


def typed(section: str) -> list[str]:
    """What a person types into MAVProxy or PX4's shell, one line each."""
    lines = re.findall(r"^    ((?:mode|arm|takeoff|commander) .*)$", _text(section), re.M)
    assert lines, f"docs/sitl.md: nothing to type in section {section!r}"
    return lines


def home(section: str) -> str:
    """The place in the commands of a section: latitude, longitude, altitude [m], heading [deg]."""
    (place,) = set(re.findall(r"(?:--home|--custom-location)[= ]([-0-9.,]+)", _text(section)))
    return str(place)


def restart_s() -> float:
    """How long systemd waits before it starts the service again [s]."""
    unit = (ROOT / "systemd" / "msp-range.service").read_text(encoding="utf-8")
    ((number, unit_of_time),) = re.findall(r"^RestartSec=([0-9.]+)(ms|s)?$", unit, re.M)
    return float(number) / (1000 if unit_of_time == "ms" else 1)


def _text(section: str) -> str:
    document = (ROOT / "docs" / "sitl.md").read_text(encoding="utf-8")
    (text,) = re.findall(rf"^## {re.escape(section)}\n(.*?)(?=^## |\Z)", document, re.M | re.S)
    return str(text)
