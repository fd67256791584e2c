"""Where a running bridge can be watched: its socket, and the address of its web page."""

import os
from pathlib import Path
from typing import NamedTuple

from msp_range.state_folder import users_folder
from msp_range.yaml_file import ConfigError

NAME = "status.sock"
SERVICE = Path("/run/msp-range") / NAME
"""The service's: systemd makes the folder (RuntimeDirectory in systemd/msp-range.service)."""


def own_socket() -> Path:
    """Path for a bridge of this process: in systemd's folder, else in this user's."""
    runtime = os.environ.get("RUNTIME_DIRECTORY")
    return Path(runtime) / NAME if runtime else _of_user()


def sockets() -> list[Path]:
    """Where a running bridge's socket may be: the service's, and this user's."""
    return [SERVICE, _of_user()]


class Outputs(NamedTuple):
    """Where a bridge's work goes, apart from its link and log."""

    record: Path | None
    """Folder for the recording instead of the airframe's."""
    socket: Path
    """Socket for those who watch, see `msp_range.watch.feed`."""
    web: str | None
    """[HOST:]PORT of the web page; None: no page."""


class Listen(NamedTuple):
    """Where the web page listens."""

    host: str
    port: int


LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Names and addresses of this computer for itself."""


ALL_FAMILIES = "::"
"""As the host of `Listen`: all addresses of this computer, IPv6 and IPv4."""


def parse_listen(text: str) -> Listen:
    """Host and port of ``[HOST:]PORT``; without a host this computer only.

    Raises
    ------
    ConfigError
        It has another form.

    Examples
    --------
    >>> parse_listen("8080"), parse_listen("[::1]:80").host
    (Listen(host='127.0.0.1', port=8080), '::1')
    """
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") or LOOPBACK[0]
    if not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
        raise ConfigError(f"--web {text}: expected [HOST:]PORT, such as 8080 or 0.0.0.0:8080")
    return Listen(host, int(port))


def _of_user() -> Path:
    return users_folder(os.environ.get("XDG_RUNTIME_DIR")) / NAME
