"""The I2C bus of the computer: interface, permission, clock. Nothing is transferred here."""

from collections.abc import Iterator

from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import RIGHT, UNKNOWN, Finding, first_of

SLOW_HZ = 50_000
"""A Raspberry Pi 1-4 reads a sensor that stretches the clock correctly up to this rate (docs/flying.md)."""
FAST_HZ = 400_000
"""The sensor's own limit, for a bus that waits while the clock is stretched."""
DEFAULT_HZ = 100_000
"""Rate of an adapter that states none: the kernel's default."""

_ON = r"(dtparam=.*\bi2c(_arm)?=on|dtoverlay=i2c-gpio)"


def check_interface(computer: Computer, path: str, stretches_clock: bool) -> Iterator[Finding]:
    """The steps before the first transfer; the first one that is wrong ends them.

    Parameters
    ----------
    stretches_clock
        Whether a sensor holds the clock low while it is not ready.
    """
    found = _device_file(computer, path)
    yield found
    if found.verdict is not RIGHT:
        return
    allowed = computer.permission("I2C permission", path, "i2c")
    yield allowed
    if allowed.verdict is RIGHT and stretches_clock:
        yield _clock(computer, path.removeprefix("/dev/"))


def _device_file(computer: Computer, path: str) -> Finding:
    name, config, is_pi = path.removeprefix("/dev/"), computer.boot_config, computer.raspberry_pi
    others = computer.names("/dev/i2c-*")
    text = f"there is no {path}{'; there is ' * bool(others)}{', '.join(others)}"
    how = f"dtparam=i2c_arm=on,i2c_arm_baudrate={SLOW_HZ} in {config}"
    return first_of(
        "I2C interface",
        (computer.exists(path), path),
        (
            computer.exists(f"/sys/bus/i2c/devices/{name}"),
            f"there is a bus {name}, but no {path}: the module i2c-dev is not loaded",
            "sudo modprobe i2c-dev, and at each boot by install.sh or /etc/modules",
        ),
        (
            is_pi and not computer.boots_with(_ON),
            f"{text}: I2C is off",
            f"enable I2C: {how} (or raspi-config), then restart the computer",
        ),
        (is_pi, f"{text}, although {config} enables one", "restart the computer, or check the bus number"),
        (others, text, "name one of these as bus: in the airframe file"),
        (True, text, "enable I2C in the computer's firmware or device tree, and load the module i2c-dev"),
    )


def _clock(computer: Computer, name: str) -> Finding:
    node = f"/sys/bus/i2c/devices/{name}/of_node"
    compatible = computer.text(f"{node}/compatible") or ""
    stated_hz = computer.number(f"{node}/clock-frequency")
    is_pi = "bcm2835" in compatible or "bcm2711" in compatible
    rate_hz = stated_hz or DEFAULT_HZ
    rate = f"{rate_hz / 1e3:g} kHz"
    return first_of(
        "I2C clock",
        ("i2c-gpio" in compatible, "bit-banged: it waits while a sensor stretches the clock"),
        (
            is_pi and rate_hz > SLOW_HZ,
            f"{rate}: a Raspberry Pi 1-4 reads 328 m where a sensor stretches the clock",
            f"dtparam=i2c_arm=on,i2c_arm_baudrate={SLOW_HZ} in {computer.boot_config}, then restart the computer",
        ),
        (is_pi, rate),
        (stated_hz is None, "this computer does not report its rate; the sensors take 400 kHz at most", None, UNKNOWN),
        (
            rate_hz > FAST_HZ,
            f"{rate}, and the sensors take {FAST_HZ / 1e3:g} at most",
            "clock-frequency of the bus in the device tree",
        ),
        (True, rate),
    )
