"""Where this program keeps what it needs again after a restart, apart from recordings."""

import os
from pathlib import Path
from tempfile import gettempdir

SERVICE_USER = "msp-range"
"""The user of the service, made by install.sh."""


def state_folder() -> Path:
    """systemd's for the service (StateDirectory), else this user's."""
    state = os.environ.get("STATE_DIRECTORY")
    if state:
        return Path(state)
    state = os.environ.get("XDG_STATE_HOME")
    home = os.environ.get("HOME")
    if state or home:
        return Path(state or f"{home}/.local/state") / "msp-range"
    return Path(gettempdir()) / f"msp-range-{os.getuid()}"
