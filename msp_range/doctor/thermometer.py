"""Thermometers that are files: there, readable, of outside air and not of the processor, plausible."""

from collections.abc import Iterator
from pathlib import Path

from msp_range.correction.temperature import COLDEST_C, HOTTEST_C, FileSource, TemperatureParameters
from msp_range.correction.thermometer import read_thermometer
from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import Finding, right, unknown, wrong

INSIDE = ("cpu", "core", "soc", "gpu", "k10temp", "acpi", "nvme", "rp1", "pmic", "bcm2", "wifi", "iwl", "phy")
"""Parts of the names of thermometers inside of computers: their chips, and no air."""
PATTERNS = ("/sys/class/hwmon/hwmon*/temp1_input", "/sys/bus/iio/devices/iio:device*/in_temp_input")


def check_files(computer: Computer, temperature: TemperatureParameters) -> Iterator[Finding]:
    """One finding for each source that is a file."""
    if not temperature.sources:
        yield unknown(
            "thermometer",
            f"none is named: {temperature.fixed_c:g} C is used, and each degree of difference costs 0.18 %",
            "name one under temperature.sources (docs/flying.md)",
        )
    for source in temperature.sources:
        if isinstance(source, FileSource):
            yield _check(computer, source)


def _check(computer: Computer, source: FileSource) -> Finding:
    step = "thermometer"
    found = computer.names(source.path)
    if not found:
        outside = [f"{path} ({name})" for path, name in _candidates(computer)]
        there = f"; there is {', '.join(outside)}" if outside else ""
        remedy = (
            "check its wires and address, and that its driver is loaded (such as dtoverlay=i2c-sensor,sht4x,addr=0x44)"
        )
        return wrong(step, f"no file fits {source.path}{there}", remedy)
    path = found[0]
    name = computer.text(Path(path).with_name("name")) or ""
    if _is_inside(name):
        remedy = "name one in outside air: /sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input finds it by its address"
        return wrong(step, f"{path} is {name}: a chip of the computer and not the air", remedy)
    try:
        value_c = read_thermometer(source.model_copy(update={"path": str(computer.at(path))})) * source.scale
    except (OSError, ValueError) as error:
        return wrong(step, f"{path} cannot be read: {error}", "check its wires; does it answer in 'msp-range scan'?")
    if not COLDEST_C <= value_c <= HOTTEST_C:
        remedy = "check scale (hwmon and iio count thousandths: 0.001) and the sensor"
        return wrong(step, f"{path} says {value_c:g} C", remedy)
    return right(step, f"{path}{f' ({name})' if name else ''} says {value_c:.1f} C")


def _candidates(computer: Computer) -> list[tuple[str, str]]:
    """Thermometers that are there and not inside of the computer: path and name."""
    paths = [path for pattern in PATTERNS for path in computer.names(pattern)]
    named = [(path, computer.text(Path(path).with_name("name")) or "?") for path in paths]
    return [(path, name) for path, name in named if not _is_inside(name)]


def _is_inside(name: str) -> bool:
    return any(part in name.lower() for part in INSIDE)
