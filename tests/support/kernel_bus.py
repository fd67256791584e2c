"""Emulated range finders behind the kernel's own I2C interface, for programs that know nothing of it.

A server under the system's Python (`kernel_bus_server.py`) holds a umockdev testbed with /dev/i2c-1 and temperature
files in /sys; a program started on it opens, reads and controls them as it would on a Raspberry Pi, with the stock
smbus2. One transfer takes about 0.3 ms. Two things differ from a kernel: a locked-up bus fails at once and not after a
second, unless `kernel_bus` is asked for that, and a signal waits for the end of the current transfer.
"""

import errno
import json
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import pytest

from msp_sim.device.device import DeviceTiming, Fault
from msp_sim.device.mb1242 import DEFAULT_ADDRESS, TIMING
from tests.support.waiting import LIMIT_S

SYSTEM_PYTHON = "/usr/bin/python3"
WRAPPER = "umockdev-wrapper"
PACKAGES = "umockdev python3-gi gir1.2-umockdev-1.0"
HWMON_FILE = Path("/sys/class/hwmon/hwmon0/temp1_input")
IIO_FILE = Path("/sys/bus/iio/devices/iio:device0/in_temp_input")

_REPOSITORY = Path(__file__).parents[2]


@dataclass(frozen=True)
class Sonar:
    """A range finder on /dev/i2c-1 that reports ``readings_cm`` one after the other, and then again.

    The times of its faults count from the moment when a program first opens the bus. ``kind`` is its driver's name.
    Where another one was pinged just before it, it reports ``disturbed_cm`` if that is given.
    """

    address: int = DEFAULT_ADDRESS
    readings_cm: Sequence[int] = (300,)
    faults: Sequence[Fault] = ()
    timing: DeviceTiming = TIMING
    kind: str = "mb1242"
    disturbed_cm: int | None = None


@dataclass(frozen=True)
class Other:
    """A device on /dev/i2c-1 that is not a sonar; ``answer`` is hexadecimal."""

    address: int
    answer: str = ""
    faults: Sequence[Fault] = ()


class Transfer(NamedTuple):
    """One I2C message; ``time_s`` is on this computer's monotonic clock, ``errno`` is 0 where it was acknowledged."""

    time_s: float
    verb: str
    address: int
    data: bytes
    errno: int


class KernelTestbed:
    """A running testbed; programs are started on it with `run` and `popen`."""

    def __init__(self, server: "subprocess.Popen[str]", root: Path) -> None:
        self._server = server
        self._programs: list[subprocess.Popen[Any]] = []
        self.root = root
        """The folder that stands for /dev and /sys. Its temperature files may be changed or removed."""

    def popen(self, arguments: Sequence[str | Path], **options: Any) -> "subprocess.Popen[Any]":
        """Start a program that sees the testbed; what is still running at the end of the testbed is killed."""
        environment = dict(options.pop("env", os.environ), UMOCKDEV_DIR=str(self.root))
        program = subprocess.Popen([WRAPPER, *map(str, arguments)], env=environment, **options)
        self._programs.append(program)
        return program

    def run(self, arguments: Sequence[str | Path], timeout_s: float = LIMIT_S) -> "subprocess.CompletedProcess[str]":
        """Run a program to its end and return its code, output and errors."""
        program = self.popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        output, errors = program.communicate(timeout=timeout_s)
        return subprocess.CompletedProcess(program.args, program.returncode, output, errors)

    def journal(self) -> list[Transfer]:
        """Every message on the bus so far, in order."""
        rows = _ask(self._server, "journal")
        return [Transfer(time, verb, address, bytes.fromhex(data), error) for time, verb, address, data, error in rows]

    def set_temperature(self, temperature_c: float) -> None:
        """Change both temperature files, `HWMON_FILE` and `IIO_FILE`."""
        for path in (HWMON_FILE, IIO_FILE):
            (self.root / path.relative_to("/")).write_text(f"{round(temperature_c * 1000)}\n")

    def set_readings(self, readings_cm: Sequence[int]) -> None:
        """Change what the sonars report, one reading for each of them."""
        self._tell(json.dumps(list(readings_cm)))

    def silence(self, address: int) -> None:
        """From now on a device acknowledges nothing."""
        self._tell(f"silence {address}")

    def time_out(self) -> None:
        """The next transfer takes the time-out of `kernel_bus`, and fails."""
        self._tell("time out")

    def _tell(self, line: str) -> None:
        assert self._server.stdin is not None
        self._server.stdin.write(line + "\n")
        self._server.stdin.flush()

    def end_programs(self) -> None:
        """Kill what is still running."""
        for program in self._programs:
            with program:
                program.kill()


@contextmanager
def kernel_bus(
    devices: Sequence[Sonar | Other],
    temperature_c: float = 22.5,
    nack_errno: int = errno.EREMOTEIO,
    seed: int = 0,
    timeout_s: float = 0.0,
) -> Iterator[KernelTestbed]:
    """A testbed with ``devices`` on /dev/i2c-1; skips the test where Debian's packages are missing, fails under CI.

    Parameters
    ----------
    devices
        What is on the bus.
    temperature_c
        What the temperature files say [deg C].
    nack_errno
        What the adapter reports where nobody acknowledges.
    seed
        Of the faults with a probability below one.
    timeout_s
        How long each transfer takes while the bus is locked up [s]. Kernel drivers give up after 1 s; more is a driver
        that hangs.
    """
    environment = {**os.environ, "PYTHONPATH": f"{_REPOSITORY / 'sim'}{os.pathsep}{_REPOSITORY}"}
    environment.pop("PYTHONHOME", None)
    # The library that the wrapper preloads belongs to the same package. Without it a program would reach a real bus.
    if shutil.which(WRAPPER) is None:
        _missing(f"no {WRAPPER}")
    try:
        server = subprocess.Popen(
            [SYSTEM_PYTHON, str(Path(__file__).with_name("kernel_bus_server.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
    except FileNotFoundError:
        _missing(f"no {SYSTEM_PYTHON}")
    with server:
        specification = {
            "devices": [asdict(device) for device in devices],
            "temperature_c": temperature_c,
            "nack_errno": nack_errno,
            "seed": seed,
            "timeout_s": timeout_s,
        }
        answer = _ask(server, json.dumps(specification))
        if "missing" in answer:
            _missing(answer["missing"])
        testbed = KernelTestbed(server, Path(answer["root"]))
        try:
            yield testbed
        finally:
            testbed.end_programs()
            assert server.stdin is not None
            server.stdin.close()
            try:
                server.wait(LIMIT_S)
            finally:
                server.kill()


def _ask(server: "subprocess.Popen[str]", line: str) -> Any:
    assert server.stdin is not None
    assert server.stdout is not None
    server.stdin.write(line + "\n")
    server.stdin.flush()
    answer = server.stdout.readline()
    if not answer:
        raise RuntimeError(f"the kernel bus server ended with code {server.wait(LIMIT_S)}: its errors are above")
    return json.loads(answer)


def _missing(what: str) -> NoReturn:
    message = f"the emulated kernel bus needs Debian's packages {PACKAGES} ({what}): apt-get install {PACKAGES}"
    if os.environ.get("CI") == "true":
        pytest.fail(message)
    pytest.skip(message)
