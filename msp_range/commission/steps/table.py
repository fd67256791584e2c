"""The steps of commissioning in their order: what each does, and the parts of the airframe that it verifies."""

from collections.abc import Callable
from typing import Any, NamedTuple

from msp_range.commission.outcome import StepOutcome
from msp_range.commission.session import Session
from msp_range.commission.steps import addresses, bench, flight, lift, parameters, wires
from msp_range.config import Airframe
from msp_range.params.settings import Firmware, settings


class Step(NamedTuple):
    """A step of the commissioning."""

    run: Callable[[Session], StepOutcome]
    """Function that guides the person through it."""
    verified: Callable[[Airframe], Any]
    """The parts of the airframe that it verifies: a change of them makes it due again."""


def _sensors(airframe: Airframe, *keys: str) -> list[Any]:
    return [{key: sensor.model_dump(mode="json")[key] for key in keys} for sensor in airframe.sensors]


STEPS: dict[str, Step] = {
    "wires": Step(
        wires.run,
        lambda airframe: [
            airframe.bus,
            sorted([sensor.shown_address, sensor.model] for sensor in airframe.sensors),
            airframe.link.model_dump(),
        ],
    ),
    "addresses": Step(addresses.run, lambda airframe: _sensors(airframe, "name", "address", "model")),
    "bench": Step(
        bench.run,
        lambda airframe: [
            [[sensor.name, sensor.position_m[2], sensor.model] for sensor in airframe.sensors],
            airframe.temperature.model_dump(mode="json"),
        ],
    ),
    "parameters": Step(
        parameters.run,
        lambda airframe: [
            airframe.link.model_dump(),
            [[setting.name, setting.value] for setting in settings(airframe, Firmware(airframe.link.autopilot), 2)],
        ],
    ),
    "lift": Step(
        lift.run,
        lambda airframe: [
            *_sensors(airframe, "name", "address", "model", "position_m", "rotation_deg"),
            *([airframe.send.standing_m] if airframe.send.standing_m else []),
            # Without distances the autopilot's own was not compared.
            *(["nothing"] if airframe.send.nothing else []),
        ],
    ),
    "hover": Step(flight.hover, flight.flown_part),
    "review": Step(flight.review, flight.flown_part),
}
