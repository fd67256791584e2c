"""A Debian with a real systemd as its first process, in a container of systemd-nspawn, with emulated sensors on I2C.

It shares the network with this computer, so that pip reaches its packages and a test receives what the bridge sends.
The sensors are those of tests/support/kernel_bus.py; programs reach them by a library that umockdev preloads.
"""

import json
import os
import shutil
import subprocess
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from evaluation import ROOT
from msp_sim.device.mb1242 import TIMING
from tests.support.waiting import LIMIT_S, until

PACKAGES = (
    "systemd,systemd-sysv,dbus,udev,passwd,python3,python3-venv,git,make,ca-certificates,procps,"
    "umockdev,python3-gi,gir1.2-umockdev-1.0"
)
"""What the container has: all that the documents ask for, and umockdev for the sensors."""
DEVICE_POLICY = ("--capability=CAP_BPF", "--system-call-filter=bpf")
"""Without these, and a unified hierarchy of control groups, the container's systemd allows a service all devices."""
HOST_TRUST = (Path("/etc/ssl/certs"), Path("/etc/pip.conf"))
"""Files of this computer without which its pip reaches no packages behind a proxy; read-only in the container."""


def missing() -> str | None:
    """What this computer lacks for such a container; None where it has all."""
    if os.geteuid() != 0:
        return "it needs root"
    absent = [each for each in ("mmdebstrap", "systemd-nspawn", "nsenter") if shutil.which(each) is None]
    return f"it needs {', '.join(absent)}: apt-get install mmdebstrap systemd-container" if absent else None


def make_debian(folder: Path, suite: str) -> Path:
    """A tar file with a minimal Debian; made once for each suite and list of packages."""
    archive = folder / f"{suite}-{zlib.crc32(PACKAGES.encode()):08x}.tar"
    if not archive.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = archive.with_suffix(".part.tar")
        subprocess.run(["mmdebstrap", "--variant=apt", f"--include={PACKAGES}", suite, str(part)], check=True)
        part.rename(archive)
    return archive


class Machine:
    """A booted container; `close` ends it. ``failed`` is 1 once a step in it was not as it should be, else 0."""

    failed = 0

    def __init__(self, archive: Path, folder: Path) -> None:
        self.root = folder / "root"
        self._log = (folder / "console.log").open("wb")
        self.root.mkdir(parents=True)
        subprocess.run(["tar", "-C", str(self.root), "-xf", str(archive)], check=True)
        self._process: subprocess.Popen[bytes] | None = None
        self.leader = 0

    def boot(self) -> None:
        """Start it, and wait until systemd has started everything."""
        binds = [f"--bind-ro={path}" for path in HOST_TRUST if path.exists()]
        command = ["systemd-nspawn", "--register=no", "--keep-unit", "--boot", f"--directory={self.root}"]
        self._process = subprocess.Popen(
            [*command, *DEVICE_POLICY, "--machine=msp-range-test", f"--bind-ro={ROOT}:/src", *binds],
            env={**os.environ, "SYSTEMD_NSPAWN_UNIFIED_HIERARCHY": "1"},
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
        )
        self.leader = 0
        self.until("end of the start of systemd", self._is_up)

    def _is_up(self) -> bool:
        assert self._process is not None
        children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
        self.leader = int(children[0]) if children else 0
        return bool(children) and self.run("systemctl is-system-running", check=False).stdout.strip() in (
            "running",
            "degraded",
        )

    def power_off(self) -> None:
        """Shut it down."""
        assert self._process is not None
        self.run("systemctl poweroff", check=False)
        self._process.wait(LIMIT_S)

    def run(self, command: str, check: bool = True, timeout_s: float = 900.0) -> "subprocess.CompletedProcess[str]":
        """Run a shell command in it; raises RuntimeError with what it printed where it fails and ``check``."""
        environment = {name: value for name, value in os.environ.items() if name.startswith(("PIP_", "http", "HTTP"))}
        environment.pop("PIP_FIND_LINKS", None)
        environment["HOME"] = "/root"
        environment["PATH"] = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
        done = subprocess.run(
            ["nsenter", f"--target={self.leader}", "--all", "sh", "-c", f"cd /root 2>/dev/null; {command}"],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s,
        )
        if check and done.returncode != 0:
            raise RuntimeError(f"{command}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}")
        return done

    def show(self, name: str, unit: str = "msp-range") -> str:
        """A property of a unit, as `systemctl show` prints it."""
        return self.run(f"systemctl show --value -p {name} {unit}").stdout.strip()

    @staticmethod
    def until(what: str, is_so: Callable[[], bool]) -> float:
        """Wait until something is so; returns how long it took [s]."""
        start_s = time.monotonic()
        until(is_so, work=lambda: time.sleep(0.05), seen=lambda: f"no {what}")
        return time.monotonic() - start_s

    def emulate_sensors(self, readings_cm: Sequence[int]) -> None:
        """Put sensors on the container's /dev/i2c-1, from 0x70 on, and let the service see them by a drop-in."""
        devices = [
            {
                "address": 0x70 + number,
                "readings_cm": [reading],
                "faults": [],
                "kind": "mb1242",
                "timing": asdict(TIMING),
            }
            for number, reading in enumerate(readings_cm)
        ]
        specification = {"devices": devices, "temperature_c": 20.0, "nack_errno": 121, "seed": 0, "timeout_s": 0.0}
        folder = self.root / "root"
        (folder / "sensors.json").write_text(json.dumps(specification) + "\n")
        # The folder of the emulated /dev is for the service's user too.
        (folder / "sensors.sh").write_text(
            "mkdir -p /srv/i2c && cd /srv/i2c && export TMPDIR=/srv/i2c PYTHONPATH=/src/sim:/src\n"
            "umask 000\n"
            "(cat /root/sensors.json; exec sleep infinity) |\n"
            "    exec python3 -B /src/tests/support/kernel_bus_server.py >/srv/i2c/answer\n"
        )
        self.run("rm -rf /srv/i2c")
        self.run("systemd-run --unit=emulated-i2c --quiet sh /root/sensors.sh")
        answer = self.root / "srv/i2c/answer"
        self.until("the emulated bus", lambda: answer.exists() and answer.read_text().endswith("\n"))
        testbed = json.loads(answer.read_text())["root"]
        self.run(f"chmod -R a+rwX {testbed} $(readlink -f {testbed}/dev/i2c-1)")
        drop_in = self.root / "etc/systemd/system/msp-range.service.d/emulated-i2c.conf"
        drop_in.parent.mkdir(parents=True, exist_ok=True)
        # A device file may be written to where all is read-only, and the file that stands for one may not.
        drop_in.write_text(
            f"[Service]\nEnvironment=LD_PRELOAD=libumockdev-preload.so.0 UMOCKDEV_DIR={testbed}\n"
            "ReadWritePaths=/srv/i2c\n"
        )
        self.run("systemctl daemon-reload")

    def close(self) -> None:
        """End it at once."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._log.close()
