"""What `msp-range params` does: print parameters, write a file of them, compare them, or set them on the autopilot.

Files are as MAVProxy, Mission Planner and QGroundControl's ArduPilot page read them: NAME,VALUE lines. Comments have
lines of their own: MAVProxy does not take them behind a value.
"""

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from msp_range.clock import Clock, stamp_of
from msp_range.config import Airframe
from msp_range.mavlink.signing import Signing
from msp_range.mavlink.transport import open_transport
from msp_range.params.client import ParameterClient, same
from msp_range.params.settings import Firmware, Setting, remarks, settings
from msp_range.yaml_file import ConfigError, read_config, write_file

CONNECT_S = 10.0
"""How long to wait for an autopilot: it sends a heartbeat each second, and a TCP or serial link may have to be opened
again meanwhile [s]."""


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
        line
        for paragraph in heading
        for line in textwrap.wrap(paragraph, 100, initial_indent="# ", subsequent_indent="# ")
    ]
    for setting in settings:
        lines += ["", f"# {setting.reason} ({setting.source})", f"{setting.name},{text_of(setting.value)}"]
    return "\n".join(lines) + "\n"


def restored(path: Path) -> list[Setting]:
    """The settings of a file, such as one that `write` left.

    Raises
    ------
    ConfigError
        It cannot be read, or a line is no parameter.
    """
    values: dict[str, float] = {}
    for number, line in enumerate(read_config(path).splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            name, value = words
            values[name] = float(value)
        except ValueError:
            raise ConfigError(f"{path}:{number}: found {line!r}; expected NAME,VALUE") from None
    return [Setting(name, value, "as it was", str(path)) for name, value in values.items()]


class Difference(NamedTuple):
    """A setting, and what the autopilot has instead; None where it does not know the parameter."""

    setting: Setting
    found: float | None


def connect(airframe: Airframe, clock: Clock, signing: Signing | None = None) -> ParameterClient:
    """The autopilot at the airframe's link.

    Parameters
    ----------
    signing
        Instead of that with the airframe's key.

    Raises
    ------
    ConfigError
        None is received there.
    """
    transport = open_transport(airframe.link.url, clock)
    client = ParameterClient(transport, clock, airframe.link, signing=signing)
    if not client.connect(CONNECT_S):
        why = f" ({transport.last_error})" if transport.last_error else ""
        transport.close()
        raise ConfigError(
            f"{airframe.link.url}: no autopilot received for {CONNECT_S:.0f} s{why}; does msp-range run use the link? "
            "'msp-range doctor' looks for the reason"
        )
    return client


def wanted(airframe: Airframe, client: ParameterClient, port: int) -> tuple[Firmware, list[Setting]]:
    """The connected autopilot's firmware and the settings for it.

    Raises
    ------
    ConfigError
        It is neither ArduPilot nor PX4, or not the one that the airframe file names.
    """
    firmware = client.firmware()
    if firmware is None:
        raise ConfigError(f"{airframe.link.url}: the autopilot is neither ArduPilot nor PX4")
    if firmware.autopilot != airframe.link.autopilot:
        raise ConfigError(
            f"{airframe.link.url}: the autopilot is {firmware}, and link.autopilot is {airframe.link.autopilot}"
        )
    return firmware, settings(airframe, firmware, port)


def differences(client: ParameterClient, some: Sequence[Setting]) -> list[Difference]:
    """The settings that the autopilot has otherwise."""
    read = [Difference(setting, client.read(setting.name)) for setting in some]
    return [
        Difference(setting, found)
        for setting, found in read
        if found is None or not (same(found, setting.value) or found == setting.as_good)
    ]


def file_text(airframe: Airframe, firmware: Firmware, port: int) -> str:
    """The file of parameters of an airframe."""
    first = f"{airframe.vehicle}: parameters of {firmware} for msp-range, in this order."
    return parm_text([first, *remarks(airframe, firmware)], settings(airframe, firmware, port))


def described(difference: Difference) -> str:
    """A line for a person."""
    setting, found = difference
    if found is None:
        return f"{setting.name}: not known by this autopilot; expected {text_of(setting.value)} ({setting.reason})"
    return f"{setting.name}: {text_of(found)} -> {text_of(setting.value)}: {setting.reason} ({setting.source})"


def write(
    client: ParameterClient,
    changes: Sequence[Difference],
    confirm: Callable[[str], bool],
    undo: Path,
    vehicle: str,
    show: Callable[[str], None] = print,
) -> Mapping[str, float]:
    """Set what a person agrees to, one after the other, and read each back; names and values that were set.

    Parameters
    ----------
    confirm
        Asks about one change.
    undo
        File to make with the values from before, of what was set; it is complete before each change.
    show
        Prints a line.

    Raises
    ------
    ConfigError
        A parameter could not be set, or ``undo`` not be written; those before it are set, and ``undo`` has their old
        values.
    """
    before: list[Setting] = []
    done: dict[str, float] = {}
    for change in changes:
        setting, found = change
        if found is None:
            show(described(change))
            continue
        if not confirm(described(change)):
            continue
        before.insert(0, Setting(setting.name, found, "before msp-range params --write", "read from the autopilot"))
        write_file(undo, parm_text([f"{vehicle}: msp-range params --restore {undo} sets these again."], before))
        try:
            done[setting.name] = client.write(setting.name, setting.value)
        except ConfigError as error:
            raise ConfigError(f"{setting.name}: {error}. Set so far: {', '.join(done) or 'nothing'}") from None
        show(f"{setting.name}: {text_of(done[setting.name])}, read back")
    return done


def undo_path(clock: Clock) -> Path:
    """A file of its own for each writing."""
    return Path(f"undo-{stamp_of(clock.utc())}.parm")
