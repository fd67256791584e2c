"""A folder for the results of a command."""

import os
from pathlib import Path

from msp_range.yaml_file import ConfigError


def make_folder(folder: Path) -> None:
    """Create a folder for results unless it exists; ConfigError if that fails, or nothing can be written into it."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder}: is a file; expected a folder for results, which is made if it does not exist")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: this folder cannot be created: {error.strerror}") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ConfigError(f"{folder}: no permission to write into this folder; name another one")
