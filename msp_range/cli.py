"""msp-range: the commands of the bridge."""

import gc
import json
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Exit, Option, Typer, confirm

from msp_range.options import AirframeFile, LinkOption, PortOption, shipped
from msp_range.params.cli import params, sign
from msp_range.plugins import installed, load_entry
from msp_range.recordings_cli import export, layout, recover, replay, tune
from msp_range.state_folder import SERVICE_AIRFRAME
from msp_range.user_errors import EXIT_COMMAND_LINE, Commands, VersionOption
from msp_range.yaml_file import ConfigError, Section

if TYPE_CHECKING:
    from msp_range.sensors.base import Driver

app = Typer(
    name="msp-range",
    help="Bridge from ultrasonic range finders on I2C to ArduPilot or PX4 by MAVLink DISTANCE_SENSOR.",
    epilog="Start with: msp-range check configs/quad_pallet.yaml, then: msp-range run configs/quad_pallet.yaml",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

FILE_KINDS = "msp_range.file_kinds"
"""Group of entry points: section class by kind of file, including those of simulator and laboratory, which are not
imported here."""


@app.callback()
def _options(version: VersionOption = False) -> None:
    """Options of the program itself."""


BusOption = Annotated[str, Option("--bus", help="I2C bus number, or the path of its device file")]
SocketOption = Annotated[
    Path | None,
    Option(help="socket by which a running bridge is watched; default: the service's, or this user's"),
]
DriverOption = Annotated[
    str | None,
    Option("--driver", help="driver name, as in sensor model files; default: by the sensor's address"),
]


@app.command()
def run(
    airframe_file: AirframeFile = SERVICE_AIRFRAME,
    log: Annotated[Literal["text", "json"], Option(help="format of log lines")] = "text",
    record: Annotated[Path | None, Option(help="folder for the recording, instead of the airframe's")] = None,
    no_record: Annotated[bool, Option("--no-record", help="record nothing")] = False,
    link: LinkOption = None,
    bus: Annotated[str | None, Option(help="I2C bus instead of the airframe's")] = None,
    web: Annotated[
        str | None,
        Option(
            metavar="[HOST:]PORT", help="serve a page that shows what the bridge does; default host: this computer only"
        ),
    ] = None,
    socket: SocketOption = None,
) -> None:
    """Fly: read the sensors and send DISTANCE_SENSOR until SIGTERM. SIGHUP reads the airframe file again.

    Exit codes: 0 stopped by SIGTERM or SIGINT, 1 an error in the program, 2 invalid command line, 3 an unusable file,
    or a bus that another process uses. Failing sensors, bus, link or disk are reported to the pilot and retried for
    ever.
    """
    if record is not None and no_record:
        raise ConfigError("--record and --no-record: give one of them")
    # The imports take some time; a service that is stopped meanwhile has also ended normally.
    for signum in (signal.SIGTERM, signal.SIGINT):
        signal.signal(signum, _leave)
    # The file has not been read yet, so there is nothing to reload.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    # Imports produce no garbage, nor does reading the airframe.
    gc.disable()
    try:
        from msp_range import service
        from msp_range.bus.smbus import bus_of
        from msp_range.config import Airframe, load_airframe
        from msp_range.log import Log
        from msp_range.watch.place import Outputs, own_socket, parse_listen

        if web is not None:
            from msp_range.extras import require

            parse_listen(web)
            require("web", "msp-range run --web")

        def load() -> Airframe:
            airframe = load_airframe(airframe_file).changed(link=link, bus=bus_of(bus) if bus is not None else None)
            if airframe.link.signing_key is not None:  # after SIGHUP too, a key that cannot be used changes nothing
                from msp_range.mavlink.signing import read_key

                read_key(Path(airframe.link.signing_key))
            return airframe.model_copy(update={"recording": None}) if no_record else airframe

        airframe = load()
    finally:
        gc.freeze()
        gc.enable()
    service.run(airframe, load, Log(log), Outputs(record, socket or own_socket(), web))


def _leave(signum: int, frame: FrameType | None) -> None:
    # Exit at once: an exception during an import may be swallowed or printed as a traceback.
    os._exit(0)


def driver_of(text: str) -> "type[Driver]":
    """The driver named on the command line."""
    from msp_range.sensors.table import find_driver

    try:
        driver = find_driver(text)
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(f"--driver: found {text!r}; {error}") from None
    if driver is None:
        raise ConfigError(f"--driver: found {text!r}; expected a kind of sensor that the bridge has a driver for")
    if driver.is_serial:
        raise ConfigError(
            f"--driver {text}: {driver.part} is on a serial port and has no address on the I2C bus; "
            "msp-range doctor AIRFRAME.yaml reads it"
        )
    return driver


@app.command()
def check(airframe_file: AirframeFile = SERVICE_AIRFRAME) -> None:
    """Read an airframe file and show its sensors, directions and streams. Touches no hardware."""
    from msp_range.check import show
    from msp_range.config import load_airframe
    from msp_range.terminal import PlainConsole

    show(load_airframe(airframe_file), PlainConsole())


@app.command()
def doctor(
    airframe_file: AirframeFile = SERVICE_AIRFRAME,
    json_lines: Annotated[bool, Option("--json", help="print one JSON object instead of text")] = False,
    bench: Annotated[
        bool,
        Option("--bench", help="instead measure what the bridge costs on this computer: start, processor, delays"),
    ] = False,
    preflight: Annotated[
        bool,
        Option(
            "--preflight",
            help="instead go or no-go within 5 s, from the running bridge if there is one; else with the heights of "
            "return and mission; exit code 0: go",
        ),
    ] = False,
) -> None:
    """Look for what is wrong, from the bus to the autopilot, and say what to do. Changes nothing.

    The sensors ping, and while the vehicle is disarmed the autopilot receives their distances for some seconds. If the
    bridge runs, bus and port are left alone. Exit code 1: something is wrong.
    """
    from msp_range.doctor.command import show, show_preflight
    from msp_range.doctor.computer import this_computer

    if bench and preflight:
        raise ConfigError("--bench and --preflight: give one of them")
    if preflight:
        raise Exit(show_preflight(airframe_file, this_computer(), json_lines))
    raise Exit(show(airframe_file, this_computer(), json_lines, bench))


@app.command()
def commission(
    airframe_file: AirframeFile = SERVICE_AIRFRAME,
    step: Annotated[
        Literal["wires", "addresses", "bench", "parameters", "lift", "hover", "review"] | None,
        Option(help="do this step only; default: all that have not passed yet"),
    ] = None,
    yes: Annotated[bool, Option("--yes", help="make every change that is proposed, and wait for no key")] = False,
    height: Annotated[
        list[float] | None,
        Option(metavar="METRES", help="measured height of the bench check; give it again for a second one"),
    ] = None,
    recording: Annotated[
        Path | None, Option(help="recording of the hover (.mcap); default: the newest of the airframe's folder")
    ] = None,
    port: PortOption = 2,
    json_lines: Annotated[
        bool, Option("--json", help="print one JSON object at the end; all else goes to standard error")
    ] = False,
    phone: Annotated[
        bool, Option("--phone", help="ask on a phone instead: a page on the network for ten minutes, with a code")
    ] = False,
    listen: Annotated[
        str, Option(metavar="[HOST:]PORT", help="where the phone's page is; with --phone")
    ] = "0.0.0.0:8643",
) -> None:
    """Commission a vehicle step by step: wires, addresses, bench, parameters, a lift by hand, hover, review.

    It measures on the vehicle, compares with the airframe file and asks before it changes the file; AIRFRAME.yaml.1 is
    the file as it was. Propellers off until the hover; it stops while the vehicle is armed. The same command goes on
    where it stopped. Exit code 1: a step has not passed.
    """
    from msp_range.clock import SystemClock
    from msp_range.commission.command import commission as do
    from msp_range.commission.operator import PersonAtTerminal
    from msp_range.commission.session import Session
    from msp_range.doctor.computer import this_computer

    clock = SystemClock()
    operator = PersonAtTerminal(yes, tuple(height or ()), sys.stderr if json_lines else sys.stdout)
    session = Session(airframe_file, this_computer(), clock, operator, recording=recording, port=port)
    if phone:
        if yes or height or json_lines:
            raise ConfigError("--phone asks on the phone: it goes without --yes, --height and --json")
        from msp_range.extras import require
        from msp_range.watch.place import parse_listen

        require("web", "msp-range commission --phone")
        from msp_range.commission.phone import by_phone

        report = by_phone(session, step, parse_listen(listen), sys.stdout)
    else:
        report = do(session, step)
    if json_lines:
        print(json.dumps(report, indent=2))
    raise Exit(int(not all(each["passed"] for each in report["steps"].values())))


@app.command()
def report(
    airframe_file: AirframeFile = SERVICE_AIRFRAME,
    out: Annotated[
        Path | None, Option(metavar="FILE.zip", help="the archive; default: in this folder, with the date in its name")
    ] = None,
) -> None:
    """Write one archive for whoever helps: files, versions, journal, doctor's findings, status, the last recording.

    The list of what is in it is printed, with what is missing and why. Keys, tokens and passwords are removed.
    """
    from msp_range.clock import SystemClock
    from msp_range.doctor.computer import this_computer
    from msp_range.report import write_report

    for line in write_report(airframe_file, out, this_computer(), SystemClock()):
        print(line, flush=True)


@app.command()
def status(
    once: Annotated[bool, Option("--once", help="print once and exit; default where there is no terminal")] = False,
    json_lines: Annotated[bool, Option("--json", help="print one JSON object and exit")] = False,
    socket: SocketOption = None,
) -> None:
    """Show what a running bridge does: distances, rejected readings, faults, air, link and recording.

    It reads the bridge's socket; neither the sensors nor the link notice. Exit code: 0 the bridge is
    active, 1 no bridge runs, 4 it starts, is critical or sends nothing: what is wrong comes first.
    """
    from msp_range.watch.terminal import show

    raise Exit(show(socket, once, json_lines))


@app.command()
def web(
    switch: Annotated[
        Literal["on", "off"] | None,
        Argument(help="on: other devices in the same network reach the page; off: this computer only"),
    ] = None,
) -> None:
    """Show who can reach the page of the installed service, its address and a QR code of it; or change that.

    Neither 'on' nor 'off' touches the bridge: only the page is started again. Both need root.
    """
    from msp_range.extras import require

    require("web", "msp-range web")
    from msp_range.web import network

    if switch is not None:
        network.switch(switch == "on")
    network.show()


@app.command()
def airframes(
    name: Annotated[
        str | None, Argument(help="the one to write; default: by questions", autocompletion=shipped(""))
    ] = None,
    into: Annotated[
        Path | None, Option(metavar="FOLDER", help="write airframe.yaml and the sensor models that it names there")
    ] = None,
) -> None:
    """List the airframes that come with the program; with --into, choose one and write it where it can be changed.

    For the service, as install.sh does: sudo msp-range airframes --into /etc/msp-range
    """
    from msp_range.airframes import ask_at_terminal, choose, described, shipped_airframes, write_into

    known = shipped_airframes()
    if name is not None and name not in known:
        raise ConfigError(f"airframes: found {name}; expected one of {', '.join(known)}")
    if into is None:
        print("\n".join(described({name: known[name]} if name else known)))
        return
    for path in write_into(known[name or choose(known, ask_at_terminal)], into):
        print(f"written: {path}")


@app.command()
def extras(
    names: Annotated[
        list[str] | None,
        Argument(metavar="[NAME]...", help="such as kalman; default: those that the airframe file needs"),
    ] = None,
    airframe_file: Annotated[
        Path, Option("--airframe", metavar="AIRFRAME.yaml", help="the vehicle, where no name is given")
    ] = SERVICE_AIRFRAME,
) -> None:
    """Install optional packages into a vehicle's installation, each checked by its hash; needs root and a network.

    install.sh and upgrades do it for the airframe file. Afterwards: sudo systemctl reload msp-range
    """
    from msp_range.extras import install, missing

    if names is None:
        from msp_range.config import read_airframe

        names = [each for each in read_airframe(airframe_file).extras if missing(each) is not None]
        if not names:
            print(f"{airframe_file} needs no packages that are not there")
    for name in names:
        install(name)
        print(f"{name}: installed")


app.command()(params)
app.command()(sign)


@app.command()
def schema(
    kind: Annotated[
        str,
        Argument(
            help="which kind of file: airframe, sensor, scenario, campaign or flights",
            autocompletion=lambda: sorted(installed(FILE_KINDS)),
        ),
    ] = "airframe",
) -> None:
    """Print the JSON Schema of a kind of file, for completion and checks in editors.

    Kinds: airframe, sensor model, scenario of a simulated flight, campaign at the bench, campaign of flights.

    Save it next to the files and name it in their first line: # yaml-language-server: $schema=airframe.schema.json
    """
    kinds = installed(FILE_KINDS)
    if kind not in kinds:
        print(f"schema {kind}: expected one of {', '.join(sorted(kinds))}", file=sys.stderr)
        raise Exit(EXIT_COMMAND_LINE)
    print(json.dumps(load_entry(kinds[kind], "kind of file", Section).model_json_schema(), indent=2))


@app.command()
def scan(
    bus: BusOption = "1",
    ping: Annotated[
        bool, Option("--ping", help="trigger a measurement of each device, to find the range finders")
    ] = False,
    driver: DriverOption = None,
) -> None:
    """List the devices that acknowledge on an I2C bus. Only reads, unless --ping is given."""
    from msp_range.bus.smbus import KernelBus, bus_of
    from msp_range.clock import SystemClock
    from msp_range.sensors.addressing import scan as scan_bus
    from msp_range.terminal import PlainConsole, plain_table

    kind = None if driver is None else driver_of(driver)
    kernel_bus = KernelBus(bus_of(bus))
    found = scan_bus(kernel_bus, SystemClock(), identify=ping, driver=kind)
    kernel_bus.close()
    if not found:
        print(f"{kernel_bus.path}: nothing acknowledges; check power, pull-ups and the two bus wires")
        return
    rows = [(f"0x{device.address:02x}", f"0x{device.address << 1:02X}", device.answer) for device in found]
    PlainConsole().print(plain_table(("7-bit", "8-bit", "what"), rows, "l", str(kernel_bus.path)))


@app.command()
def address(
    old: Annotated[str, Argument(help="the sensor's present 7-bit address, e.g. 0x70")],
    new: Annotated[str, Argument(help="its new 7-bit address, e.g. 0x71")],
    bus: BusOption = "1",
    yes: Annotated[bool, Option("--yes", help="do not ask")] = False,
    driver: DriverOption = None,
) -> None:
    """Change a sensor's address: shows the bus, refuses changes that could lose the sensor, verifies the result."""
    from msp_range.bus.smbus import KernelBus, bus_of
    from msp_range.clock import SystemClock
    from msp_range.sensors.addressing import change_address, check_new_address
    from msp_range.sensors.addressing import scan as scan_bus
    from msp_range.sensors.table import drivers_at

    old_address, new_address = _address(old), _address(new)
    kind = drivers_at(old_address)[0] if driver is None else driver_of(driver)
    check_new_address(new_address, kind)
    kernel_bus, clock = KernelBus(bus_of(bus)), SystemClock()
    for device in scan_bus(kernel_bus, clock, identify=False):
        print(f"{kernel_bus.path}: 0x{device.address:02x} acknowledges {device.answer}".rstrip())
    if not yes:
        confirm(f"Move the sensor at 0x{old_address:02x} to 0x{new_address:02x}?", abort=True)
    found = change_address(kernel_bus, clock, old_address, new_address, kind)
    kernel_bus.close()
    until = "" if kind.keeps_address else " until its power is switched off"
    print(f"0x{found.address:02x}: {found.answer}; the sensor has moved and keeps this address{until}")


def _address(text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise ConfigError(f"address {text!r}: expected a 7-bit address such as 0x70 or 112") from None


for command in (replay, tune, recover, export, layout):
    app.command()(command)


def main() -> None:
    """Entry point of the command."""
    app()
