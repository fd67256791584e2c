"""The computer's facts: files below a root folder, a user with groups, a clock, free space.

``/`` is the root of the computer that the program runs on. Nothing here changes a file.
"""

import grp
import os
import pwd
import re
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from msp_range.clock import SystemClock
from msp_range.doctor.finding import Finding, first_of
from msp_range.mavlink.transport.url import NetworkUrl, SerialUrl, TransportUrl
from msp_range.state_folder import SERVICE_USER

BOOT_CONFIGS = ("/boot/firmware/config.txt", "/boot/config.txt")
"""The Raspberry Pi's configuration, newest place first."""


_DEVICE = re.compile(r"/dev/[\w/.-]+")
"""The path of a device in a command line."""


@dataclass(frozen=True)
class User:
    """Who is to use the devices: name, number, and the numbers of its groups as its processes have them."""

    name: str
    uid: int
    gids: frozenset[int]


def user_of_this_program() -> User:
    """The service's user where root asks and there is one: root itself may use everything; else the own user."""
    if os.geteuid() == 0:
        try:
            entry = pwd.getpwnam(SERVICE_USER)
        except KeyError:
            return User("root", 0, frozenset())
        return User(SERVICE_USER, entry.pw_uid, frozenset(os.getgrouplist(SERVICE_USER, entry.pw_gid)))
    try:
        name = pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        name = str(os.geteuid())
    return User(name, os.geteuid(), frozenset([os.getegid(), *os.getgroups()]))


@dataclass(frozen=True)
class Computer:
    """Facts of a computer."""

    root: Path
    """Its root folder."""
    user: User
    """Who is to use its devices."""
    utc_s: Callable[[], float]
    """Its date [s since 1970]."""
    disk: Callable[[Path], os.statvfs_result] = os.statvfs
    """The disk of an existing path of this program."""

    def at(self, path: str | Path) -> Path:
        """Where this program finds a path of the computer."""
        return self.root / str(path).lstrip("/")

    def exists(self, path: str | Path) -> bool:
        """Whether there is such a file, also where it may not be read."""
        return os.path.lexists(self.at(path))

    def text(self, path: str | Path) -> str | None:
        """A file's content without what ends it; None where it cannot be read."""
        try:
            return self.at(path).read_bytes().decode(errors="replace").strip("\0\n ")
        except OSError:
            return None

    def number(self, path: str | Path) -> int | None:
        """A device tree's number, most significant byte first; None where there is none."""
        try:
            return int.from_bytes(self.at(path).read_bytes(), "big")
        except OSError:
            return None

    def names(self, pattern: str) -> list[str]:
        """Paths of the computer that fit a pattern."""
        return sorted(f"/{each.relative_to(self.root)}" for each in self.root.glob(pattern.lstrip("/")))

    def target(self, path: str) -> str:
        """What a path is in the end: /dev/serial0 is a link to another name."""
        seen = path
        for _ in range(8):
            if not self.at(seen).is_symlink():
                break
            seen = os.path.normpath(os.path.join(os.path.dirname(seen), os.readlink(self.at(seen))))
        return seen

    @property
    def is_raspberry_pi(self) -> bool:
        """Whether it is a Raspberry Pi of any model."""
        return "Raspberry Pi" in (self.text("/proc/device-tree/model") or "")

    @property
    def boot_config(self) -> str:
        """Name of the file that switches I2C and serial ports on."""
        return next((name for name in BOOT_CONFIGS if self.exists(name)), BOOT_CONFIGS[0])

    def boots_with(self, pattern: str) -> bool:
        """Whether a line of that file, not commented out, fits a pattern."""
        lines = (self.text(self.boot_config) or "").splitlines()
        return any(re.match(pattern, line.split("#")[0].strip()) for line in lines)

    def holders(self, url: TransportUrl) -> Iterator[tuple[int, str]]:
        """Other processes that have a link's port or connection: number and command.

        What the process of another user has open is not to be seen; then those whose command names a serial port.
        """
        targets = {self.target(url.path)} if isinstance(url, SerialUrl) else set(self._sockets(url))
        for folder in self.root.glob("proc/[0-9]*"):
            command = (self.text(f"/proc/{folder.name}/cmdline") or "").replace("\0", " ")
            if int(folder.name) == os.getpid():
                continue
            try:
                opened = [_target_of(link) for link in folder.joinpath("fd").iterdir()]
            except OSError:
                opened = _DEVICE.findall(command)
            if any(self.target(each) in targets for each in opened):
                yield int(folder.name), command or "?"

    def _sockets(self, url: NetworkUrl) -> Iterator[str]:
        """Sockets at this computer's port of a link, or connected to another one's, as the kernel names them."""
        protocol, column = url.kind[:3], 1 if url.kind.endswith("in") else 2
        for name in (protocol, f"{protocol}6"):
            for line in (self.text(f"/proc/net/{name}") or "").splitlines()[1:]:
                fields = line.split()
                if int(fields[column].split(":")[1], 16) == url.port:
                    yield f"socket:[{fields[9]}]"

    def may_write(self, path: str) -> bool:
        """Whether the user may read and write a file, by its mode."""
        found = self.at(path).stat()
        if self.user.uid == 0:
            return True
        if found.st_uid == self.user.uid:
            bits = stat.S_IRUSR | stat.S_IWUSR
        elif found.st_gid in self.user.gids:
            bits = stat.S_IRGRP | stat.S_IWGRP
        else:
            bits = stat.S_IROTH | stat.S_IWOTH
        return found.st_mode & bits == bits

    def owner(self, path: str | Path) -> str | None:
        """Name of the user whom a file belongs to; None where it has none."""
        uid = str(self.at(path).stat().st_uid)
        return next((fields[0] for fields in self._table("/etc/passwd", 7) if fields[2] == uid), None)

    def permission(self, step: str, path: str, usual_group: str) -> Finding:
        """Whether the user may use a device, and how it is to be allowed."""
        found, user, groups = self.at(path).stat(), self.user.name, self._table("/etc/group", 4)
        group = next((name for name, _, number, _ in groups if number == str(found.st_gid)), None)
        group = group or _group_here(found.st_gid)
        is_member = any(name == group and user in members.split(",") for name, _, _, members in groups)
        text = f"{user} may not use {path} (group {group}, mode {stat.S_IMODE(found.st_mode):04o})"
        return first_of(
            step,
            (self.may_write(path), f"{user} may use {path}"),
            (
                not found.st_mode & stat.S_IWGRP or group == "root",
                text,
                f"install the udev rule that gives it to the group {usual_group}: sudo ./install.sh",
            ),
            (is_member, f"{text}; {user} is in that group since after this login", "log out and in again"),
            (True, text, f"sudo usermod -aG {group} {user}, then log out and in again"),
        )

    def _table(self, path: str, columns: int) -> list[list[str]]:
        """The lines of a file such as /etc/passwd that have this number of columns."""
        lines = (self.text(path) or "").splitlines()
        return [fields for line in lines if len(fields := line.split(":")) == columns]


def _group_here(gid: int) -> str:
    """A group that only this program's computer names."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _target_of(link: Path) -> str:
    """What a link leads to; nothing where it is there no more."""
    try:
        return os.readlink(link)
    except FileNotFoundError:
        return ""


def this_computer() -> Computer:
    """The one that the program runs on."""
    return Computer(Path("/"), user_of_this_program(), SystemClock().utc)
