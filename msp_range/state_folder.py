"""What install.sh makes of the service, and where this program keeps what it needs again after a restart."""

import os
from pathlib import Path
from tempfile import gettempdir

SERVICE_USER = "msp-range"
"""The user of the service, made by install.sh."""
SERVICE_FOLDER = Path("/var/lib/msp-range")
"""Its working folder, with its recordings."""
SERVICE_AIRFRAME = Path("/etc/msp-range/airframe.yaml")
"""The service's airframe file, made by install.sh: that of each command which is given none."""
CHOOSE_AIRFRAME = f"sudo msp-range airframes --into {SERVICE_AIRFRAME.parent}"
"""The command that makes it by questions."""


def state_folder() -> Path:
    """systemd's for the service (StateDirectory), else this user's."""
    service, user, home = map(os.environ.get, ("STATE_DIRECTORY", "XDG_STATE_HOME", "HOME"))
    if service:
        return Path(service)
    return users_folder(user or (home and f"{home}/.local/state"))


def users_folder(parent: str | None) -> Path:
    """This program's folder in one of this user's; without one in that for temporary files."""
    return Path(parent) / "msp-range" if parent else Path(gettempdir()) / f"msp-range-{os.getuid()}"
