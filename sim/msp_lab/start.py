"""Where the command begins; see `msp_range.start`."""

import msp_range.start  # noqa: F401


def main() -> None:
    """Entry point of the command msp-lab."""
    from msp_lab.cli import main as command

    command()
