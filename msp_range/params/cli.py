"""The commands of msp-range that ask the connected autopilot: params and sign."""

from pathlib import Path
from typing import Annotated, Literal

from typer import Exit, Option, confirm, prompt

from msp_range.options import AirframeFile, LinkOption, PortOption
from msp_range.state_folder import SERVICE_AIRFRAME
from msp_range.yaml_file import ConfigError, write_file


def params(
    airframe_file: AirframeFile = SERVICE_AIRFRAME,
    out: Annotated[Path | None, Option(help="file to write (.parm) instead of printing")] = None,
    vehicle: Annotated[
        Literal["copter", "plane", "sub", "rover"], Option(help="ArduPilot's vehicle, where none is connected")
    ] = "copter",
    before_4_7: Annotated[bool, Option("--before-4.7", help="names and units of ArduPilot before 4.7")] = False,
    port: PortOption = 2,
    compare: Annotated[bool, Option("--compare", help="compare with the connected autopilot's values")] = False,
    write: Annotated[bool, Option("--write", help="set them, with a question for each change")] = False,
    restore: Annotated[Path | None, Option(help="set the values of this file (.parm) instead")] = None,
    link: LinkOption = None,
) -> None:
    """Print the autopilot's parameters for an airframe, compare them with the autopilot's, or set them there.

    Parameters are set only while the vehicle is disarmed. Exit code 1: --compare found differences.
    """
    from msp_range.clock import SystemClock
    from msp_range.config import load_airframe
    from msp_range.params import commands
    from msp_range.params.settings import Firmware

    if compare + write + (restore is not None) > 1:
        raise ConfigError("--compare, --write and --restore: give one of them")
    airframe = load_airframe(airframe_file).changed(link=link)
    if not (compare or write or restore):
        text = commands.file_text(airframe, Firmware(airframe.link.autopilot, vehicle, before_4_7), port)
        print(text, end="") if out is None else _save(out, text)
        return
    to_restore = None if restore is None else commands.restored(restore)
    clock = SystemClock()
    client = commands.connect(airframe, clock)
    firmware, settings = commands.wanted(airframe, client, port)
    if out is not None:
        _save(out, commands.file_text(airframe, firmware, port))
    if to_restore is not None:
        settings = to_restore
    changes = commands.differences(client, settings)
    print(f"{firmware}: {len(settings) - len(changes)} of {len(settings)} parameters are as they should be")
    if not (write or restore):
        for change in changes:
            print(commands.described(change))
        raise Exit(bool(changes))
    undo = commands.undo_path(clock)
    done = commands.write(client, changes, lambda text: confirm(f"{text}\nSet it?"), undo, airframe.vehicle)
    if done:
        print(f"{len(done)} set. Restart the autopilot. To undo: msp-range params {airframe_file} --restore {undo}")


def _save(path: Path, text: str) -> None:
    write_file(path, text)
    print(f"written: {path}")


def sign(
    airframe_file: AirframeFile = SERVICE_AIRFRAME,
    passphrase: Annotated[
        bool,
        Option("--passphrase", help="make the key from a passphrase, as ground stations do; default: at random"),
    ] = False,
    remove: Annotated[bool, Option("--remove", help="make the autopilot accept unsigned messages again")] = False,
    link: LinkOption = None,
) -> None:
    """Make a key for MAVLink signing, and give it to the connected autopilot. The key is never printed.

    The key's file is the airframe's link.signing_key; one that exists is used. Only while the vehicle is disarmed. Send
    keys over a cable, since whoever reads along has the key.
    """
    from msp_range.clock import SystemClock
    from msp_range.config import load_airframe
    from msp_range.params import keys

    airframe = load_airframe(airframe_file).changed(link=link)
    key_file = keys.key_file(airframe)
    if remove:
        keys.give(airframe, SystemClock(), removes=True)
        print(f"the autopilot does not sign any more; take link.signing_key out of {airframe_file}")
        return
    if not key_file.exists():
        text = prompt("passphrase", hide_input=True, confirmation_prompt=True) if passphrase else None
        keys.make(key_file, text)
        print(f"made: {key_file}")
    elif passphrase:
        raise ConfigError(f"{key_file}: there is a key already; remove the file to make another one")
    keys.give(airframe, SystemClock())
    print("the autopilot signs with this key; restart the bridge to sign too")
