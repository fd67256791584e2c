"""Options and arguments that several commands have."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from msp_range.yaml_file import SHIPPED


def shipped(kind: str) -> Callable[[str], list[str]]:
    """Completion in a shell by the names in a folder of `SHIPPED`; of paths, if any begins so, by the shell itself."""

    def complete(incomplete: str) -> list[str]:
        from glob import escape, iglob

        if any(iglob(f"{escape(incomplete)}*")):
            return []
        return [file.stem for file in (SHIPPED / kind).glob("*.yaml") if file.stem.startswith(incomplete)]

    return complete


AirframeFile = Annotated[
    Path, Argument(metavar="AIRFRAME.yaml", help="the vehicle: an airframe file", autocompletion=shipped(""))
]
LinkOption = Annotated[str | None, Option(help="link URL instead of the airframe's")]
PortOption = Annotated[
    int,
    Option(
        min=0, max=9, help="the autopilot's port with the bridge: n of ArduPilot's SERIALn (0 to 9), of PX4's TELEM n"
    ),
]
