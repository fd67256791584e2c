"""`msp-range web`: whether other devices reach the page of the service, at which address, and what protects it."""

import fcntl
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TextIO

import segno

from msp_range.watch.place import LOOPBACK
from msp_range.yaml_file import ConfigError

UNIT = Path("/etc/systemd/system/msp-range-web.service")
PACKAGED = Path("/usr/lib/systemd/system") / UNIT.name
"""Where install.sh and the Debian package have the page's unit."""
DROP_IN = UNIT.with_name(f"{UNIT.name}.d") / "network.conf"
TOKEN = Path("/var/lib/msp-range/web-token")
AVAHI = Path("/run/avahi-daemon/socket")
"""It is there while avahi gives this computer the name NAME.local in its networks."""
PORT = 8642
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
    """Let other devices reach the page, or this computer only; the bridge is not restarted.

    Raises
    ------
    ConfigError
        There is no page, this user may not change it, or it does not start.
    """
    if not (UNIT.exists() or PACKAGED.exists()):
        raise ConfigError(f"{UNIT}: not there, so no page is installed; sudo ./install.sh installs it")
    try:
        if on:
            DROP_IN.parent.mkdir(exist_ok=True)
            DROP_IN.write_text(CONTENT)
        else:
            DROP_IN.unlink(missing_ok=True)
            TOKEN.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigError(f"{error.filename}: {error.strerror}; with sudo, then again") from None
    for command in (["daemon-reload"], ["restart", UNIT.name]):
        if subprocess.run(["systemctl", *command]).returncode != 0:
            raise ConfigError(f"systemctl {' '.join(command)} failed: journalctl -u {UNIT.stem} -n 20 says why")


def show() -> None:
    """Print who can reach the page and where; on a terminal with a QR code.

    Raises
    ------
    ConfigError
        This user may not read the token.
    """
    if not DROP_IN.exists():
        print(f"Only this computer reaches the page: http://{LOOPBACK[0]}:{PORT}/")
        print("For a phone in the same network: sudo msp-range web on")
        return
    try:
        token = TOKEN.read_text().strip()
    except OSError as error:
        raise ConfigError(f"{TOKEN}: {error.strerror}; it has the address's token: sudo msp-range web") from None
    urls = [f"http://{host}:{PORT}/?token={token}" for host in hosts()]
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
    """This computer's IPv4 addresses in its networks, those of wireless ones first, and its name there."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            with suppress(OSError):  # it has no address
                answer = fcntl.ioctl(asking, GET_ADDRESS, struct.pack("256s", name.encode()))
                found.append((not name.startswith("wl"), name, socket.inet_ntoa(answer[20:24])))
    addresses = [address for _, _, address in sorted(found) if not address.startswith("127.")]
    return [*addresses, *([f"{socket.gethostname()}.local"] if AVAHI.exists() and addresses else [])]
