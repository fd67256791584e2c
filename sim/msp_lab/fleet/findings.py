"""What was found in a fleet, as the records of ``fleet.json`` and the rows of ``fleet.csv``."""

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Literal

Kind = Literal["shared", "odd", "change", "drift", "calibration"]


@dataclass(frozen=True)
class UnitEstimate:
    """One number of one sensor."""

    vehicle: str
    sensor: str
    """Whose."""
    value: float
    error: float
    """From its own readings, and the standard error."""
    shrunk: float
    low: float
    high: float
    """Drawn towards the fleet's mean, with its 95 % interval."""
    odd: bool
    """It is an odd one out."""
    p_value: float
    """That it deviates from the others by random variation."""


@dataclass(frozen=True)
class SessionEstimate:
    """One number in one session of a sensor, and its standard error."""

    session: str
    value: float
    error: float


@dataclass(frozen=True)
class FleetEffect:
    """One number over the fleet."""

    kind: Kind
    """``shared``: the fleet has it; ``odd``: only some; ``change`` or ``drift``: it became another one;
    ``calibration``: the fleet's is another one than the sensor model's, and nothing is wrong."""
    name: str
    parameter: str
    unit: str
    """Effect of the catalogue or number of the base, its parameter and unit."""
    shape: tuple[tuple[str, float], ...]
    """Its other parameters, which are the same for all."""
    plain: str
    """What was found, in words."""
    alternatives: tuple[tuple[str, float], ...]
    """Effects that explain it as well, and how much less they gain [nat]."""
    mean: float | None = None
    low: float | None = None
    high: float | None = None
    """Of the ordinary vehicles, with its 95 % interval; None of a change."""
    tau: float = 0.0
    i2: float = 0.0
    """Standard deviation between vehicles, and the share of the scatter that it is."""
    omega: float = 0.0
    """Standard deviation between sessions of a vehicle."""
    estimates: tuple[UnitEstimate, ...] = ()
    """Of each sensor; of a change the size of it, of the one that changed."""
    since: str = ""
    """First session after a change."""
    sessions: tuple[SessionEstimate, ...] = ()
    """Of a change, the estimates by session."""

    @property
    def unit_label(self) -> str:
        """The unit in brackets after a space; nothing for a plain number."""
        return "" if self.unit in ("1", "") else f" [{self.unit}]"

    @property
    def odd(self) -> tuple[UnitEstimate, ...]:
        """The odd ones out."""
        return tuple(estimate for estimate in self.estimates if estimate.odd)


@dataclass(frozen=True)
class LeftOut:
    """A sensor of which the readings could not be used, and why."""

    vehicle: str
    sensor: str
    why: str


@dataclass(frozen=True)
class FleetFindings:
    """Everything that was found."""

    sentence: str
    """The answer, for an operator."""
    dataset: str
    model: str
    """What was compared."""
    vehicles: int
    sensors: int
    sessions: int
    readings: int
    """How many."""
    effects: tuple[FleetEffect, ...]
    """What was found, and if nothing was, the sensors' constant offsets."""
    found: int
    """How many of them are findings."""
    left_out: tuple[LeftOut, ...]
    """Sensors that were not used."""
    fdr: float
    tests: int
    """False-discovery rate, and the number of hypotheses that were tested."""
    untestable: tuple[tuple[str, tuple[str, ...]], ...]
    """Columns that no vehicle has, with the effects that need them."""
    seed: int
    date: str
    version: str
    """For the record."""

    def as_json(self) -> str:
        """All numbers."""
        return json.dumps(asdict(self), indent=2) + "\n"

    def as_csv(self) -> str:
        """A row for each number of each sensor."""
        text = io.StringIO()
        rows = list(self._rows())
        writer = csv.DictWriter(text, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return text.getvalue()

    def _rows(self) -> Iterator[dict[str, str]]:
        for effect in self.effects:
            for estimate in effect.estimates:
                yield {
                    "kind": effect.kind,
                    "effect": effect.name,
                    "parameter": effect.parameter,
                    "unit": effect.unit,
                    "vehicle": estimate.vehicle,
                    "sensor": estimate.sensor,
                    "since": effect.since,
                    "odd": "yes" if estimate.odd else "no",
                    "value": _digits(estimate.value),
                    "std_error": _digits(estimate.error),
                    "shrunk": _digits(estimate.shrunk),
                    "shrunk_low": _digits(estimate.low),
                    "shrunk_high": _digits(estimate.high),
                    "p_value": _digits(estimate.p_value),
                    "fleet_mean": _digits(effect.mean),
                    "fleet_low": _digits(effect.low),
                    "fleet_high": _digits(effect.high),
                    "between_vehicles_std": _digits(effect.tau),
                }


def _digits(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"
