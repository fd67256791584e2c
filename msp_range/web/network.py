"""`msp-range web`: whether other devices reach the page of the service, at which address, and what protects it."""

import fcntl
import ipaddress
import math
import shlex
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TextIO

import segno

from msp_range.state_folder import SERVICE_FOLDER
from msp_range.watch.place import ALL_FAMILIES, LOOPBACK, Listen, parse_listen
from msp_range.yaml_file import ConfigError

UNIT = Path("/etc/systemd/system/msp-range-web.service")
PACKAGED = Path("/usr/lib/systemd/system") / UNIT.name
"""Where install.sh and the Debian package have the page's unit."""
DROP_IN = UNIT.with_name(f"{UNIT.name}.d") / "network.conf"
TOKEN = SERVICE_FOLDER / "web-token"
AVAHI = Path("/run/avahi-daemon/socket")
"""It is there while avahi gives this computer the name NAME.local in its networks."""
PORT = 8642
ROUTES = Path("/proc/net/route")
ADDRESSES_6 = Path("/proc/net/if_inet6")
INTERFACES = Path("/sys/class/net")
INNER = ("docker", "veth", "br-", "virbr", "lxc", "podman", "cni")
"""Beginnings of names of interfaces that containers and virtual machines of this computer have: no phone is there."""
NOT_FOR_OTHERS = 0x01 | 0x20 | 0x40
"""Flags of an IPv6 address that is not shown: it changes within a day, is about to go, or is not confirmed yet
(IFA_F_TEMPORARY, IFA_F_DEPRECATED and IFA_F_TENTATIVE of linux/if_addr.h)."""
CONTENT = f"""# Written by 'msp-range web on', removed by 'msp-range web off'.
[Service]
Environment=LISTEN=0.0.0.0:{PORT}
"""
GET_ADDRESS = 0x8915
"""SIOCGIFADDR of netdevice(7)."""
PROTECTION = """Who has this address sees the page, and can add marks to the recording; the page changes nothing else.
The address has a token, and without it nobody gets in. The connection is not encrypted: who listens in the same
network can read all of it, the token too. Use it in a network that you trust.
Off again, and the token with it: sudo msp-range web off"""


def switch(on: bool) -> None:
    """Let other devices reach the page, from now on at each start, or this computer only; the bridge is not restarted.

    Raises
    ------
    ConfigError
        There is no page, this user may not change it, it does not start, or a file of the owner's says otherwise.
    """
    if not (UNIT.exists() or PACKAGED.exists()):
        raise ConfigError(f"{UNIT}: not there, so no page is installed; sudo ./install.sh installs it")
    _systemctl("--version", stdout=subprocess.DEVNULL)  # without it nothing is written
    try:
        if on:
            DROP_IN.parent.mkdir(exist_ok=True)
            DROP_IN.write_text(CONTENT)
        else:
            DROP_IN.unlink(missing_ok=True)
            TOKEN.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigError(f"{error.filename}: {error.strerror}; with sudo, then again") from None
    # A page that is disabled would be gone after the next boot, and the address with it.
    for command in (["daemon-reload"], ["restart", UNIT.name], *([["enable", "--quiet", UNIT.name]] if on else [])):
        if _systemctl(*command).returncode != 0:
            raise ConfigError(f"systemctl {' '.join(command)} failed: journalctl -u {UNIT.stem} -n 20 says why")
    found = listen()
    if (found.host not in LOOPBACK) != on:
        who = "only this computer reaches" if on else "other devices still reach"
        raise ConfigError(
            f"{who} the page: another file sets LISTEN to {found.host}, port {found.port}; "
            f"systemctl cat {UNIT.stem} shows which, and sudo systemctl edit {UNIT.stem} changes it"
        )


def listen() -> Listen:
    """Where the page listens, as systemd has it of the unit and all its drop-ins.

    Raises
    ------
    ConfigError
        There is no systemd, or LISTEN is no address.
    """
    shown = _systemctl("show", "-p", "Environment", UNIT.name, stdout=subprocess.PIPE).stdout
    words = shlex.split(shown.removeprefix("Environment="))
    found = [word.removeprefix("LISTEN=") for word in words if word.startswith("LISTEN=")]
    return parse_listen(found[-1] if found else str(PORT))


def _systemctl(*words: str, stdout: int | None = None) -> "subprocess.CompletedProcess[str]":
    try:
        return subprocess.run(["systemctl", *words], stdout=stdout, text=True)
    except OSError as error:
        raise ConfigError(f"systemctl: {error.strerror}; the page of the service needs systemd") from None


def show() -> None:
    """Print who can reach the page and where; on a terminal with a QR code.

    Raises
    ------
    ConfigError
        There is no systemd, or this user may not read the token.
    """
    found = listen()
    if found.host in LOOPBACK:
        print(f"Only this computer reaches the page: http://{LOOPBACK[0]}:{found.port}/")
        print("For a phone in the same network: sudo msp-range web on")
        return
    try:
        token = TOKEN.read_text().strip()
    except OSError as error:
        raise ConfigError(f"{TOKEN}: {error.strerror}; it has the address's token: sudo msp-range web") from None
    names = {"0.0.0.0": hosts(), ALL_FAMILIES: [*hosts(), *hosts_6()]}.get(found.host, [found.host])
    urls = [f"http://{f'[{name}]' if ':' in name else name}:{found.port}/?token={token}" for name in names]
    if not urls and hosts_6():
        print("This computer has IPv6 addresses only, and the page has IPv4. To open it on them, which may be")
        print(f"reached from the whole internet: sudo systemctl edit {UNIT.stem}, with these lines, and restart it")
        print(f"[Service]\nEnvironment=LISTEN=[{ALL_FAMILIES}]:{found.port}")
        return
    if not urls:
        print("This computer is in no network; in one: sudo msp-range web")
        return
    show_code(urls[0], sys.stdout)
    print("Other devices in the same network reach the page:", *urls, PROTECTION, sep="\n")


def show_code(url: str, out: TextIO) -> None:
    """Write an address as a QR code, where ``out`` is a terminal."""
    if out.isatty():
        out.write("\x1b[97;40m")  # white on black, in terminals with a light background too
        segno.make(url, error="l").terminal(out, compact=True)
        out.write("\x1b[0m")


def hosts() -> list[str]:
    """This computer's IPv4 addresses in its networks, that of a phone most likely first, and its name there.

    Wireless networks come first, also before the one that leads to the internet: an access point of the vehicle's own
    does not lead there, and has the phone.
    """
    metrics = _default_routes()
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            with suppress(OSError):  # it has no address
                answer = fcntl.ioctl(asking, GET_ADDRESS, struct.pack("256s", name.encode()))
                if name in metrics or _is_outer(name):
                    order = not name.startswith("wl"), metrics.get(name, math.inf), name
                    found.append((*order, socket.inet_ntoa(answer[20:24])))
    addresses = [address for *_, address in sorted(found) if not address.startswith("127.")]
    return [*addresses, *([f"{socket.gethostname()}.local"] if AVAHI.exists() and addresses else [])]


def hosts_6() -> list[str]:
    """This computer's lasting IPv6 addresses in its networks; not those of one link, which browsers do not take."""
    found = []
    with suppress(OSError):
        for line in ADDRESSES_6.read_text().splitlines():
            digits, _, _, scope, flags, name = line.split()
            if int(scope, 16) == 0 and not int(flags, 16) & NOT_FOR_OTHERS and _is_outer(name):
                found.append((not name.startswith("wl"), name, str(ipaddress.IPv6Address(int(digits, 16)))))
    return [address for _, _, address in sorted(found)]


def _is_outer(name: str) -> bool:
    """Whether an interface is connected, and to something outside this computer as far as its name says."""
    if name.startswith(INNER):
        return False
    carrier = INTERFACES / name / "carrier"
    try:
        return carrier.read_text().strip() == "1"
    except FileNotFoundError:  # a container without /sys
        return True
    except OSError:  # it is switched off
        return False


def _default_routes() -> dict[str, int]:
    """The metric of each interface that has an IPv4 route to everywhere; the smallest one is used."""
    found: dict[str, int] = {}
    with suppress(OSError):
        for line in ROUTES.read_text().splitlines()[1:]:
            name, destination, _, _, _, _, metric, mask = line.split()[:8]
            if int(destination, 16) == int(mask, 16) == 0:
                found[name] = min(int(metric), found.get(name, int(metric)))
    return found
