"""The I2C bus of the computer: interface, permission, clock. Nothing is transferred here."""

from collections.abc import Iterator

from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import Finding, Verdict, right, unknown, wrong

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
    if found.verdict is not Verdict.RIGHT:
        return
    allowed = computer.permission("I2C permission", path, "i2c")
    yield allowed
    if allowed.verdict is Verdict.RIGHT and stretches_clock:
        yield _clock(computer, path.removeprefix("/dev/"))


def _device_file(computer: Computer, path: str) -> Finding:
    step = "I2C interface"
    if computer.exists(path):
        return right(step, path)
    name = path.removeprefix("/dev/")
    others = computer.names("/dev/i2c-*")
    there = f"; there is {', '.join(others)}" if others else ""
    text = f"there is no {path}{there}"
    config = computer.boot_config
    if computer.exists(f"/sys/bus/i2c/devices/{name}"):
        text = f"there is a bus {name}, but no {path}: the module i2c-dev is not loaded"
        return wrong(step, text, "sudo modprobe i2c-dev, and at each boot by install.sh or /etc/modules")
    if computer.raspberry_pi and not computer.boots_with(_ON):
        how = f"dtparam=i2c_arm=on,i2c_arm_baudrate={SLOW_HZ} in {config}"
        return wrong(step, f"{text}: I2C is off", f"enable I2C: {how} (or raspi-config), then restart the computer")
    if computer.raspberry_pi:
        return wrong(step, f"{text}, although {config} enables one", "restart the computer, or check the bus number")
    if others:
        return wrong(step, text, "name one of these as bus: in the airframe file")
    return wrong(step, text, "enable I2C in the computer's firmware or device tree, and load the module i2c-dev")


def _clock(computer: Computer, name: str) -> Finding:
    step = "I2C clock"
    node = f"/sys/bus/i2c/devices/{name}/of_node"
    compatible = computer.text(f"{node}/compatible") or ""
    stated_hz = computer.number(f"{node}/clock-frequency")
    if "i2c-gpio" in compatible:
        return right(step, "bit-banged: it waits while a sensor stretches the clock")
    if "bcm2835" in compatible or "bcm2711" in compatible:
        rate_hz = stated_hz or DEFAULT_HZ
        if rate_hz <= SLOW_HZ:
            return right(step, f"{rate_hz / 1e3:g} kHz")
        return wrong(
            step,
            f"{rate_hz / 1e3:g} kHz: a Raspberry Pi 1-4 reads 328 m where a sensor stretches the clock",
            f"dtparam=i2c_arm=on,i2c_arm_baudrate={SLOW_HZ} in {computer.boot_config}, then restart the computer",
        )
    if stated_hz is None:
        return unknown(step, "this computer does not report its rate; the sensors take 400 kHz at most")
    if stated_hz > FAST_HZ:
        remedy = "clock-frequency of the bus in the device tree"
        return wrong(step, f"{stated_hz / 1e3:g} kHz, and the sensors take {FAST_HZ / 1e3:g} at most", remedy)
    return right(step, f"{stated_hz / 1e3:g} kHz")
