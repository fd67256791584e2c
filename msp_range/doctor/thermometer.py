"""Thermometers that are files: there, readable, of outside air and not of the processor, plausible."""

from collections.abc import Iterator
from pathlib import Path

from msp_range.correction.temperature import COLDEST_C, HOTTEST_C, FileSource, TemperatureParameters
from msp_range.correction.thermometer import read_thermometer
from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import Finding, first_of, unknown, wrong
from msp_range.pilot_texts import NAME_THERMOMETER

INSIDE = ("cpu", "core", "soc", "gpu", "k10temp", "acpi", "nvme", "rp1", "pmic", "bcm2", "wifi", "iwl", "phy")
"""Parts of the names of thermometers inside of computers: their chips, and no air."""
PATTERNS = ("/sys/class/hwmon/hwmon*/temp1_input", "/sys/bus/iio/devices/iio:device*/in_temp_input")


def check_files(computer: Computer, temperature: TemperatureParameters) -> Iterator[Finding]:
    """One finding for each source that is a file."""
    if not temperature.sources:
        yield unknown(
            "thermometer",
            f"none is named: {temperature.fixed_c:g} C is used, and each degree of difference costs 0.18 %",
            NAME_THERMOMETER,
        )
    for source in temperature.sources:
        if isinstance(source, FileSource):
            yield _check(computer, source)


def _check(computer: Computer, source: FileSource) -> Finding:
    step, found = "thermometer", [(path, _name(computer, path)) for path in computer.names(source.path)]
    if not found:
        paths = [(path, _name(computer, path) or "?") for pattern in PATTERNS for path in computer.names(pattern)]
        outside = ", ".join(f"{path} ({name})" for path, name in paths if not _is_inside(name))
        return wrong(
            step,
            f"no file fits {source.path}{'; there is ' * bool(outside)}{outside}",
            "check its wires and address, and that its driver is loaded (such as dtoverlay=i2c-sensor,sht4x,addr=0x44)",
        )
    path, name = found[0]
    if _is_inside(name):
        remedy = "name one in outside air: /sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input finds it by its address"
        return wrong(step, f"{path} is {name}: a chip of the computer and not the air", remedy)
    try:
        value_c = read_thermometer(source.model_copy(update={"path": str(computer.at(path))})) * source.scale
    except (OSError, ValueError) as error:
        return wrong(step, f"{path} cannot be read: {error}", "check its wires; does it answer in 'msp-range scan'?")
    return first_of(
        step,
        (
            not COLDEST_C <= value_c <= HOTTEST_C,
            f"{path} says {value_c:g} C",
            "check scale (hwmon and iio count thousandths: 0.001) and the sensor",
        ),
        (True, f"{path}{f' ({name})' if name else ''} says {value_c:.1f} C"),
    )


def _name(computer: Computer, path: str) -> str:
    """What a thermometer's driver calls it; nothing where it does not."""
    return computer.text(Path(path).with_name("name")) or ""


def _is_inside(name: str) -> bool:
    return any(part in name.lower() for part in INSIDE)
