"""Install the Debian package on Debians with a real systemd, upgrade it, remove and purge it: `make test-install`.

Prints what was seen at each step, and ends with exit code 1 at the first thing that is not as it should be. Needs root,
mmdebstrap and systemd-nspawn; the package is made of the last commit, which needs the package index.
"""

import argparse
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

from evaluation import ROOT
from evaluation.install.machine import Machine, missing
from evaluation.install.trial import (
    READINGS_CM,
    RESTARTED_S,
    SUDO,
    Receiver,
    booted,
    differences,
    expect,
    is_active,
    is_served,
    megabytes,
    recordings,
    say,
    snapshot,
)

SUITES = ("bookworm", "trixie")
"""Debian 12 and 13, for which the package is."""
AIRFRAME = "/etc/msp-range/airframe.yaml"


def make_package(folder: Path) -> Path:
    """The package of the last commit for this kind of processor."""
    command = [sys.executable, "-m", "release", "--no-image", "--machine", "x86_64", "--out", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True)
    (package,) = folder.glob("*.deb")
    return package


def install(machine: Machine, package: Path, check: bool = True) -> "subprocess.CompletedProcess[str]":
    """Install a package, with no way to a package index."""
    shutil.copy(package, machine.root / "root/msp-range.deb")
    return machine.run("PIP_INDEX_URL=http://127.0.0.1:9 dpkg -i msp-range.deb", check=check)


def starts(machine: Machine, receiver: Receiver, package: Path) -> None:
    """The package, an airframe, and the two services."""
    start_s = time.monotonic()
    install(machine, package)
    say(f"    installed in {time.monotonic() - start_s:.0f} s, {megabytes(machine)} MB")
    (machine.root / AIRFRAME[1:]).write_text(
        (ROOT / "configs/loopback.yaml").read_text().replace(":14550", f":{receiver.port}")
        + "recording:\n  folder: /var/lib/msp-range/flights\n"
    )
    machine.run("systemctl enable --quiet --now msp-range msp-range-web")
    receiver.await_distance()
    expect(is_served(machine), "distances arrive and the page is served")


def is_upgraded(machine: Machine, receiver: Receiver, package: Path) -> None:
    """A newer package, then one that cannot use the airframe file."""
    before = {unit: machine.show("MainPID", unit) for unit in ("msp-range", "msp-range-web")}
    machine.run(f"echo '# edited by its owner' >>{AIRFRAME}")
    install(machine, package)
    expect(receiver.await_distance() < RESTARTED_S, "distances arrive")
    expect(is_served(machine), "the page is served")
    for unit, pid in before.items():
        expect(machine.show("MainPID", unit) not in (pid, "0"), f"{unit} runs the new version")
    expect("by its owner" in machine.run(f"cat {AIRFRAME}").stdout, "the airframe file is kept")
    expect(machine.run("ls -d /opt/msp-range/venv-*").stdout.count("\n") == 1, "the old environment is removed")
    is_reached(machine)
    pid = machine.show("MainPID")
    machine.run(f"echo 'colour: red' >>{AIRFRAME}")
    done = install(machine, package, check=False)
    why = re.findall("^msp-range: .*", done.stderr, re.M)
    expect(done.returncode == 1 and len(why) == 1, f"a file that it cannot use: {why[0]!r}")
    expect(machine.show("MainPID") == pid, "and the old version went on without a pause")
    machine.run(f"sed -i '/^colour/d' {AIRFRAME}; dpkg --configure -a")
    receiver.await_distance()


def is_reached(machine: Machine) -> None:
    """A phone's address, which the package has to remove again."""
    machine.run(f"{SUDO}; sudo msp-range web on")
    url = re.findall(r"http://\S+", machine.run("msp-range web").stdout)[0]
    expect(is_served(machine, url), "'msp-range web on' opens the page of the package")


def is_removed(machine: Machine, before: str) -> None:
    """dpkg --remove keeps what is the owner's, --purge does not."""
    machine.run("dpkg --remove msp-range")
    expect(not is_active(machine) and not is_active(machine, "msp-range-web"), "both services are gone")
    expect(machine.run("test -e /usr/bin/msp-range", check=False).returncode != 0, "and the command")
    expect("by its owner" in machine.run(f"cat {AIRFRAME}").stdout, "the airframe file is kept")
    expect(bool(recordings(machine)), "the recordings are kept")
    machine.run("dpkg --purge msp-range")
    left = machine.run("find / -xdev -path /proc -prune -o -name '*msp*range*' ! -path '/root/*' -print").stdout.split()
    left = [each for each in left if not each.startswith(("/var/tmp/systemd-private", "/sys/", "/src/"))]
    expect(left == [], f"--purge leaves no file {' '.join(left)}".strip())
    say(f"    changed in /etc, /opt, /usr/local, /var/lib and /root: {differences(before, snapshot(machine))}")
    expect(machine.run("id msp-range", check=False).returncode != 0, "no user is left")


def starts_by_its_own_words(machine: Machine, package: Path) -> None:
    """The commands that a new installation prints, as they stand there."""
    printed = install(machine, package).stdout
    commands = re.findall(r"^    (sudo .*)$", printed, re.M)
    expect(len(commands) == 3, f"it prints {commands}")
    choose, commission, start = commands
    machine.run(f"{SUDO}; {choose} loopback")
    done = machine.run(f"timeout 10 {commission.removeprefix('sudo ')}", check=False)
    expect("and give the code" in done.stdout, "a phone gets an address and a code")
    machine.run(f"{SUDO}; {start}")
    expect(is_active(machine) and is_served(machine), "the bridge and the page run")
    machine.run("dpkg --purge msp-range")


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--suite", choices=SUITES, action="append", help="Debian release (default: both)")
    parser.add_argument("--package", type=Path, help="the package; default: it is made of the last commit")
    parser.add_argument("--before", type=Path, help="an older package, to upgrade from; default: the same")


def main(given: argparse.Namespace) -> int:
    """Run all steps on each Debian; the exit code."""
    absent = missing()
    if absent is not None:
        say(f"make test-install: {absent}")
        return 3
    package = given.package or make_package(ROOT / "build/install/release")
    return max(on_debian(suite, package, given.before or package) for suite in given.suite or SUITES)


def on_debian(suite: str, package: Path, before: Path) -> int:
    """Run all steps on one Debian; the exit code."""
    with booted(suite) as machine:
        receiver = Receiver()
        say(f"{suite}: {before.name}, then {package.name}")
        clean = snapshot(machine)
        machine.emulate_sensors(READINGS_CM)
        starts(machine, receiver, before)
        is_upgraded(machine, receiver, package)
        is_removed(machine, clean)
        machine.run("systemctl stop emulated-i2c")
        machine.emulate_sensors(READINGS_CM)
        starts_by_its_own_words(machine, package)
    return machine.failed
