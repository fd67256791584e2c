"""Install msp-range on a fresh Debian with a real systemd, break it, upgrade it and remove it: `make test-install`.

Prints what was seen at each step, and ends with exit code 1 at the first thing that is not as it should be. Takes some
minutes, most of them for pip; needs root, mmdebstrap and systemd-nspawn.
"""

import argparse
import re
import shutil
import subprocess
import time
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

from evaluation import ROOT
from evaluation.install.machine import Machine, missing
from evaluation.install.trial import (
    OPT_PYTHON,
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
from release.wheels import MACHINES, PYTHONS, download

MAX_INSTALLED_MB = 300
"""The bridge's environment may be this large, as docs/developing.md says."""
MAX_EXPOSURE = 2.0
"""What `systemd-analyze security` may find at most: 0 is a service that can do nothing, 10 one that can do all."""
INSTALL = "sudo ./install.sh"
"""As docs/installing.md shows it."""
WEB_ON = "sudo msp-range web on"
"""As docs/watching.md shows it."""
EMPTY_DISK_MB = 24
MAX_BRIDGE_MB, MAX_PAGE_MB = 170, 60
"""What bridge and page may hold in memory."""


def install(machine: Machine, receiver: Receiver) -> None:
    """A fresh clone, one command."""
    (machine.root / "root/airframe.yaml").write_text(
        (ROOT / "configs/loopback.yaml").read_text().replace(":14550", f":{receiver.port}")
        + "recording:\n  folder: /var/lib/msp-range/flights\n"
    )
    subprocess.run(["git", "clone", "-q", "--bare", ROOT, machine.root / "srv/msp-range.git"], check=True)
    machine.run("git config --global safe.directory '*' && git clone -q /srv/msp-range.git")
    # What is not committed yet is tested too.
    changed = subprocess.run(
        ["git", "ls-files", "-mo", "--exclude-standard"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()
    for name in changed:
        to = machine.root / "root/msp-range" / name
        to.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, to)
    before = snapshot(machine)
    machine.run("cd msp-range && ./install.sh --dry-run --airframe quad_pallet")
    expect(snapshot(machine) == before, "--dry-run changes nothing")
    for options, code in (("--what", 2), ("--purge", 2), ("", 2), ("--airframe nowhere", 2), ("--upgrade", 3)):
        done = machine.run(f"cd msp-range && ./install.sh {options}", check=False)
        expect(done.returncode == code, f"install.sh {options}: exit code {code}, {done.stderr.splitlines()[-1]!r}")
    expect(snapshot(machine) == before, "and a wrong command line changes nothing")
    # Nobody answers the question, and the person goes away.
    done = machine.run("cd msp-range && script -qec ./install.sh /dev/null", check=False)
    expect(done.returncode == 3 and "How many range finders" in done.stdout, "at a terminal it asks about the vehicle")
    after = snapshot(machine)
    expect(after == before, f"and without an answer changes nothing {differences(before, after)}".strip())

    start_s = time.monotonic()
    done = machine.run("cd msp-range && ./install.sh --airframe /root/airframe.yaml")
    installed_s = time.monotonic() - start_s
    say(done.stdout)
    ending = done.stdout[done.stdout.index("Only this computer") :]
    expect("http://127.0.0.1:8642/" in ending, "it ends with the address of the page,")
    expect("wrong    I2C interface: there is no /dev/i2c-1" in ending, "what is wrong,")
    expect("\nNext, when that is done: msp-range doctor" in ending, "and the next command")
    say(f"    installed in {installed_s:.0f} s")
    expect(receiver.await_distance() < RESTARTED_S, "distances arrive")
    expect(megabytes(machine) <= MAX_INSTALLED_MB, f"{megabytes(machine)} MB in /opt/msp-range")
    pid = machine.show("MainPID")
    user = machine.run(f"stat -c %U /proc/{pid}").stdout.strip()
    expect(user == "msp-range", f"it runs as {user}")
    expect(machine.run("systemctl is-enabled msp-range").stdout.strip() == "enabled", "enabled at boot")
    exposure = machine.run("systemd-analyze security --no-pager msp-range").stdout.splitlines()[-1]
    found = float(re.findall(r": ([0-9.]+)", exposure)[0])
    expect(found <= MAX_EXPOSURE, exposure.strip())
    nice = machine.run(f"ps -o ni= -p {pid}").stdout.strip()
    expect(nice == "-10", f"nice {nice}")
    expect(bool(recordings(machine)), "it records")
    expect("msp-range " in machine.run("msp-range --version").stdout, "the command msp-range is there")
    shown = machine.run("runuser -u nobody -- msp-range status || test $? = 4").stdout
    expect("distance down" in shown, "msp-range status shows it to any user")
    expect(is_served(machine), "the page is served")
    line = machine.run("journalctl -u msp-range -o short-iso --no-pager | grep -m 1 started").stdout.strip()
    expect(len(re.findall(r"\d\d:\d\d:\d\d", line)) == 1, f"one time in a line of the journal: {line!r}")
    priorities = machine.run('journalctl -u msp-range -o json --no-pager | grep -c \'"PRIORITY":"4"\'').stdout
    expect(int(priorities) > 0, "which knows what is a warning")
    exposure = machine.run("systemd-analyze security --no-pager msp-range-web").stdout.splitlines()[-1]
    expect(float(re.findall(r": ([0-9.]+)", exposure)[0]) <= MAX_EXPOSURE, exposure.strip())
    pages = machine.run("pgrep -f msp_range.web").stdout.split()
    resident_mb = [resident(machine, each) for each in (pid, pages[0])]
    expect(
        resident_mb[0] <= MAX_BRIDGE_MB and resident_mb[1] <= MAX_PAGE_MB, f"resident: bridge, page: {resident_mb} MB"
    )
    done = machine.run(f"cd msp-range && {SUDO}; {INSTALL}", check=False)
    expect(done.returncode == 0, "installing once more does no harm")
    receiver.await_distance()


def is_reached_by_a_phone(machine: Machine, receiver: Receiver) -> None:
    """`msp-range web on` and `off`, while the bridge flies on."""
    pid = machine.show("MainPID")
    expect("only this computer" in machine.run("msp-range web").stdout.lower(), "at first nobody else reaches the page")
    say(machine.run(f"{SUDO}; {WEB_ON}").stdout)
    url = re.findall(r"http://\S+", machine.run("msp-range web").stdout)[0]
    expect(is_served(machine, url), "the address that it prints has the page")
    expect(not is_served(machine, url.partition("?")[0]), "and without its token nobody gets in")
    refused = machine.run("runuser -u nobody -- msp-range web", check=False)
    expect(refused.returncode == 3, f"another user does not get it: {refused.stderr.strip()!r}")
    machine.run("msp-range web off")
    expect(not is_served(machine, url) and is_served(machine), "off: this computer only")
    expect(machine.show("MainPID") == pid, "the bridge was not restarted")
    receiver.await_distance()


def has_a_unit_of_before(machine: Machine, receiver: Receiver) -> None:
    """The page was a part of the bridge's unit, and becomes one of its own."""
    unit = "/etc/systemd/system/msp-range.service"
    machine.run("systemctl disable -q --now msp-range-web; rm /etc/systemd/system/msp-range-web.service")
    machine.run(f"sed -i 's/^ExecStart=.*/& --web 8642/' {unit}; sha256sum {unit} >>/opt/msp-range/installed.sha256")
    machine.run("systemctl daemon-reload; systemctl restart msp-range")
    Machine.until("page", lambda: is_served(machine))
    machine.run("cd msp-range && ./install.sh --upgrade")
    receiver.await_distance()
    expect("--web" not in machine.run(f"cat {unit}").stdout, "the bridge's unit has no page any more")
    expect(is_active(machine, "msp-range-web") and is_served(machine), "the page has a unit of its own")


DEVICES = {
    "i2c-7": ("i2c", 89, 7),
    "ttyAMA0": ("ttyAMA", 204, 64),
    "ttyUSB0": ("ttyUSB", 188, 0),
    "ttyACM0": ("ttyACM", 166, 0),
    "ttyTHS1": ("ttyTHS", 238, 1),
}
"""Device files of I2C buses and serial ports: the name of their driver in the kernel's /proc/devices, major, minor."""
OTHERS = {"hwrng": (10, 183), "vcs": (7, 0)}
"""Device files that are none of the service's business."""
PROBE = """
import errno, os
for name in %s:
    try:
        os.open(f"/dev/{name}", os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY)
        print(name, "opened")
    except OSError as error:
        print(name, errno.errorcode[error.errno])
"""


def has_devices(machine: Machine, _: Receiver) -> None:
    """Device files by which the service may reach a device, with the kernel's list of drivers."""
    for name, (_driver, major, minor) in DEVICES.items():
        group = "i2c" if name.startswith("i2c") else "dialout"
        machine.run(f"mknod -m 660 /dev/{name} c {major} {minor} && chgrp {group} /dev/{name}")
    for name, (major, minor) in OTHERS.items():
        machine.run(f"mknod -m 666 /dev/{name} c {major} {minor}")
    (machine.root / "srv/probe.py").write_text(PROBE % [*DEVICES, *OTHERS])
    # The unit as it is installed, with another program.
    machine.run(
        "sed -e 's|^ExecStart=.*|ExecStart=/usr/bin/python3 /srv/probe.py|' -e 's|^Type=.*|Type=oneshot|'"
        " -e '/^Restart/d' -e '/^WatchdogSec/d' -e '/^RuntimeDirectory/d' -e '/^ExecReload/d'"
        " /etc/systemd/system/msp-range.service >/etc/systemd/system/probe.service && systemctl daemon-reload"
    )
    # This computer has none of these: no driver answers (ENXIO) where the service may open the file.
    refused = dict.fromkeys([*DEVICES, *OTHERS], "EPERM")
    expect(probed(machine) == refused, "a device whose driver is loaded later is refused until the next start")
    lines = "".join(f"\\n{major} {driver}" for driver, major, _minor in DEVICES.values())
    machine.run(f"sed 's/^Character devices:/&{lines}/' /proc/devices >/root/devices")
    machine.run("mount --bind /root/devices /proc/devices")
    allowed = refused | dict.fromkeys(DEVICES, "ENXIO")
    expect(probed(machine) == allowed, f"it may open {', '.join(DEVICES)}, and not {', '.join(OTHERS)}")
    machine.run("umount /proc/devices; rm /root/devices /srv/probe.py /etc/systemd/system/probe.service")
    machine.run(f"rm {' '.join(f'/dev/{name}' for name in [*DEVICES, *OTHERS])}; systemctl daemon-reload")


def probed(machine: Machine) -> dict[str, str]:
    """What became of opening each device file: 'opened', or the error's name."""
    machine.run("systemctl start probe && journalctl --sync")
    # Not by _COMM: on a busy computer the journal asks for it when the program has ended.
    lines = machine.run("journalctl -u probe -o cat --no-pager").stdout.splitlines()
    results = [line.split(" ") for line in lines if line.partition(" ")[0] in {*DEVICES, *OTHERS}]
    return dict(results[-len(DEVICES) - len(OTHERS) :])


def resident(machine: Machine, pid: str) -> int:
    """Resident memory of a process [MB]."""
    return int(machine.run(f"awk '/VmRSS/ {{print $2}}' /proc/{pid}/status").stdout) // 1024


def has_wheels() -> None:
    """Every package of the lock files as a wheel with its hash: nothing is compiled on the vehicle's computer."""
    for python, machine in product(PYTHONS, MACHINES):
        with TemporaryDirectory() as folder:
            for lock in ROOT.glob("requirements*.lock"):
                download(lock, python, machine, Path(folder))
        expect(True, f"wheels for Python {python} on {machine}")


def restarts(machine: Machine) -> int:
    """How often systemd has started it again."""
    return int(machine.show("NRestarts"))


def is_killed(machine: Machine, receiver: Receiver) -> None:
    """kill -9, five times in a row."""
    before = restarts(machine)
    outages = []
    for _ in range(5):
        machine.run("systemctl kill --signal=KILL msp-range")
        outages.append(receiver.await_distance())
    expect(restarts(machine) == before + 5, "killed five times, started five times")
    expect(max(outages) < RESTARTED_S, "outages of " + ", ".join(f"{outage:.2f}" for outage in outages) + " s")


def hangs(machine: Machine, receiver: Receiver) -> None:
    """A bus whose driver does not return."""
    before = restarts(machine)
    machine.run("systemctl kill --signal=STOP emulated-i2c")
    took_s = Machine.until("watchdog", lambda: restarts(machine) > before)
    machine.run("systemctl kill --signal=CONT emulated-i2c")
    receiver.await_distance()
    journal = machine.run("journalctl -u msp-range -o cat --no-pager").stdout
    expect("in _transfer" in journal, f"a hang: ended after {took_s:.1f} s, and the journal has the line where it hung")


def loses_its_disk(machine: Machine, receiver: Receiver) -> None:
    """A disk that is full, and one on which the folder is gone and cannot be made again."""
    before = restarts(machine)
    folder = "/var/lib/msp-range"
    machine.run("systemctl stop msp-range")
    machine.run(f"mount -t tmpfs -o size={EMPTY_DISK_MB}m,uid=$(id -u msp-range),gid=$(id -g msp-range) none {folder}")
    machine.run("systemctl start msp-range")
    receiver.await_distance()
    machine.run(f"head -c {EMPTY_DISK_MB}M /dev/zero >{folder}/full || true")
    receiver.await_text("not recording, disk full")
    receiver.await_distance()
    machine.run(f"rm {folder}/full")
    receiver.await_text("recording again")
    machine.run(f"chown root {folder}; chmod 755 {folder}; rm -r {folder}/flights")
    receiver.await_text("not recording")
    receiver.await_distance()
    machine.run(f"systemctl stop msp-range; umount {folder}; systemctl start msp-range")
    receiver.await_distance()
    expect(restarts(machine) <= before, "no disk restarts it")


def has_an_invalid_file(machine: Machine, receiver: Receiver) -> None:
    """A user error in the airframe file: reported once, not started again and again."""
    airframe = machine.root / "etc/msp-range/airframe.yaml"
    good = airframe.read_text()
    airframe.write_text(good + "colour: red\n")
    machine.run("systemctl restart msp-range", check=False)
    Machine.until("failure", lambda: machine.show("ActiveState") == "failed")
    expect(machine.show("ExecMainStatus") == "3", "an invalid airframe file: exit code 3, not started again")
    journal = machine.run("journalctl -u msp-range -o cat --no-pager -n 8").stdout
    expect("colour" in journal, "and the journal names the place")
    program = 'from websockets.sync.client import connect; print(connect("ws://127.0.0.1:8642/live").recv())'
    shown = ""

    def says_why() -> bool:
        nonlocal shown
        shown = machine.run(f"{OPT_PYTHON} -c '{program}'", check=False).stdout
        return "colour" in shown

    Machine.until("reason on the page", says_why)
    reason = re.findall('No distances: [^"]*', shown)[0]
    say(f"    ok: and the page says why: {reason!r}")
    airframe.write_text(good + "# edited by its owner\n")
    machine.run("systemctl restart msp-range")
    receiver.await_distance()


def needs_an_extra(machine: Machine, receiver: Receiver) -> None:
    """The airframe file is changed to one with a Kalman filter; what check advises is done as it stands there."""
    airframe = machine.root / "etc/msp-range/airframe.yaml"
    text = airframe.read_text()
    new = "send:\n  sensors: [front_left]\nfilters: [{filter: kalman}]\n"
    airframe.write_text(re.sub(r"send:\n  fused:.*\n", new, text))
    refused = machine.run("msp-range check", check=False)
    remedy = re.findall("(sudo msp-range extras .*);", refused.stderr)
    expect(refused.returncode == 3 and len(remedy) == 1, f"check refuses it: {refused.stderr.strip()!r}")
    start_s = time.monotonic()
    machine.run(f"{SUDO}; {remedy[0]}")
    say(f"    installed in {time.monotonic() - start_s:.0f} s, {megabytes(machine)} MB")
    machine.run("msp-range check && systemctl reload msp-range")
    receiver.await_distance()
    machine.run("cd msp-range && ./install.sh --upgrade")
    receiver.await_distance()
    machine.run(f"{OPT_PYTHON} -c 'import filterpy'")
    say("    ok: an upgrade brings it, too")
    airframe.write_text(text)
    machine.run("systemctl reload msp-range")


def is_upgraded(machine: Machine, receiver: Receiver) -> None:
    """A newer version, with files that the owner has edited; then one that does not start, and one that cannot read."""
    kept = recordings(machine)
    machine.run("sed -i 's/^__version__.*/__version__ = \"9.9.1\"/' msp-range/msp_range/__init__.py")
    machine.run("echo '# edited by its owner' >>/etc/systemd/system/msp-range.service")
    machine.run("echo '# a new comment' >>msp-range/systemd/msp-range.rules")
    done = machine.run("cd msp-range && ./install.sh --upgrade")
    say(done.stdout)
    receiver.await_distance()
    expect("9.9.1" in machine.run("msp-range --version").stdout, "the new version is there")
    expect("by its owner" in machine.run("cat /etc/msp-range/airframe.yaml").stdout, "the airframe file is kept")
    unit = machine.run("cat /etc/systemd/system/msp-range.service").stdout
    expect("by its owner" in unit, "an edited unit is kept")
    machine.run("test -e /etc/systemd/system/msp-range.service.new")
    rules = machine.run("cat /etc/udev/rules.d/70-msp-range.rules").stdout
    expect("a new comment" in rules, "a rules file that nobody edited is replaced")
    expect(set(kept) <= set(recordings(machine)), "recordings are kept")
    expect(machine.run("ls -d /opt/msp-range/venv-*").stdout.count("\n") == 1, "the old environment is removed")

    machine.run("cd msp-range && git stash -q -- msp_range/bridge.py; echo 'raise SystemExit(1)' >>msp_range/bridge.py")
    done = machine.run("cd msp-range && ./install.sh --upgrade", check=False)
    expect(done.returncode == 1, f"a version that does not start: exit code 1, {done.stderr.splitlines()[-1]!r}")
    receiver.await_distance()
    expect(machine.show("ActiveState") == "active", "and the old version runs")
    machine.run(
        "cd msp-range && git checkout -q msp_range/bridge.py && echo 'raise SystemExit(1)' >>msp_range/config.py"
    )
    pid = machine.show("MainPID")
    done = machine.run("cd msp-range && ./install.sh --upgrade", check=False)
    expect(done.returncode == 3, f"a version that cannot read the file: exit code 3, {done.stderr.splitlines()[-1]!r}")
    expect(machine.show("MainPID") == pid, "and the old version went on without a pause")


def boots_again(machine: Machine, receiver: Receiver) -> None:
    """The computer is switched off and on."""
    machine.power_off()
    machine.boot()
    Machine.until("start at boot", lambda: int(machine.show("NRestarts")) > 0 or is_active(machine))
    machine.emulate_sensors(READINGS_CM)
    machine.run("systemctl restart msp-range")
    receiver.await_distance()
    say("    ok: it starts at boot")


def is_removed(machine: Machine) -> None:
    """--uninstall keeps what is the owner's, --purge does not."""
    say(machine.run("cd msp-range && ./install.sh --uninstall").stdout)
    units = (f"/etc/systemd/system/msp-range{each}.service" for each in ("", "-web"))
    for gone in ("/opt/msp-range", *units, "/usr/local/bin/msp-range"):
        expect(machine.run(f"test -e {gone}", check=False).returncode != 0, f"{gone} is gone")
    expect(machine.show("LoadState") == "not-found" or not is_active(machine), "the service is gone")
    expect("by its owner" in machine.run("cat /etc/msp-range/airframe.yaml").stdout, "the airframe file is kept")
    expect(bool(recordings(machine)), "the recordings are kept")
    say(machine.run("cd msp-range && ./install.sh --uninstall --purge").stdout)
    # systemd keeps the folder for PrivateTmp of a service that a shutdown ended, in /var/tmp.
    left = machine.run("find /etc /opt /usr /var/lib /var/log /var/cache /home -name '*msp*range*'").stdout.strip()
    expect(left == "", f"--purge leaves no file {left}".strip())
    expect(machine.run("id msp-range", check=False).returncode != 0, "and no user")


def asks_at_a_terminal(machine: Machine) -> None:
    """The answers of a person: four sensors that look down, not canted, an autopilot on a serial port."""
    machine.run("sed -i '/^raise SystemExit/d' msp-range/msp_range/config.py")  # as it was before is_upgraded
    done = machine.run(r"cd msp-range && printf '2\n2\n2\n1\n' | script -qec './install.sh --no-web' /dev/null")
    say(done.stdout)
    chosen = machine.run("runuser -u msp-range -- cat /etc/msp-range/airframe.yaml").stdout
    expect(chosen == (ROOT / "configs/quad_pallet.yaml").read_text(), "the service reads quad_pallet")
    expect(machine.show("ActiveState") == "active", "and runs")


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--suite", default="bookworm", help="Debian release (default: %(default)s)")
    parser.add_argument("--keep", action="store_true", help="keep the container's folder")


def main(given: argparse.Namespace) -> int:
    """Run all steps; the exit code."""
    absent = missing()
    if absent is not None:
        say(f"make test-install: {absent}")
        return 3
    say(f"has wheels: {has_wheels.__doc__}")
    has_wheels()
    with booted(given.suite, given.keep) as machine:
        receiver = Receiver()
        machine.emulate_sensors(READINGS_CM)
        for step in (
            install,
            has_devices,
            is_killed,
            hangs,
            loses_its_disk,
            has_an_invalid_file,
            is_reached_by_a_phone,
            has_a_unit_of_before,
            needs_an_extra,
            is_upgraded,
            boots_again,
        ):
            say(f"{step.__name__.replace('_', ' ')}: {step.__doc__}")
            step(machine, receiver)
        say(f"is removed: {is_removed.__doc__}")
        is_removed(machine)
        say(f"asks at a terminal: {asks_at_a_terminal.__doc__}")
        asks_at_a_terminal(machine)
    return machine.failed
