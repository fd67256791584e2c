"""Options and arguments that several commands have."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

AirframeFile = Annotated[Path, Argument(metavar="AIRFRAME.yaml", help="the vehicle: an airframe file")]
LinkOption = Annotated[str | None, Option(help="link URL instead of the airframe's")]
PortOption = Annotated[
    int,
    Option(
        min=0, max=9, help="the autopilot's port with the bridge: n of ArduPilot's SERIALn (0 to 9), of PX4's TELEM n"
    ),
]
