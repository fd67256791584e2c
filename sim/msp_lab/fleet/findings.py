"""What was found in a fleet, as the records of ``fleet.json`` and the rows of ``fleet.csv``."""

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Literal

Kind = Literal["shared", "odd", "group", "change", "drift", "calibration", "compared"]


@dataclass(frozen=True)
class UnitEstimate:
    """One number of one sensor."""

    vehicle: str
    sensor: str
    """Names of the vehicle and the sensor."""
    value: float
    error: float
    """Estimate from the sensor's own readings, and its standard error."""
    shrunk: float
    low: float
    high: float
    """The estimate shrunk towards the fleet's mean, with its 95 % interval."""
    odd: bool
    """Whether it is an odd one."""
    p_value: float
    """Probability of such a deviation from the others by random variation."""


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
    """``shared``: the whole fleet has it; ``odd``: only some vehicles; ``group``: those that a column tells from the
    others; ``change`` or ``drift``: it changed between sessions; ``calibration``: the whole fleet has another value
    than the sensor model, which is no fault; ``compared``: nothing was found in this number."""
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
    """Mean of the ordinary vehicles, with its 95 % interval; None for a change."""
    tau: float = 0.0
    i2: float = 0.0
    """Standard deviation between vehicles, and its share of the scatter of their estimates."""
    omega: float = 0.0
    """Standard deviation between sessions of a vehicle."""
    estimates: tuple[UnitEstimate, ...] = ()
    """Estimates of each sensor; for a change its size in the sensor that changed."""
    group: str = ""
    """The column and the word of a group."""
    since: str = ""
    """First session after a change."""
    sessions: tuple[SessionEstimate, ...] = ()
    """For a change, the estimates by session."""

    @property
    def unit_label(self) -> str:
        """The unit in brackets after a space; nothing for a plain number."""
        return "" if self.unit in ("1", "") else f" [{self.unit}]"

    @property
    def odd(self) -> tuple[UnitEstimate, ...]:
        """The estimates of odd sensors."""
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
    """Folder of the readings, and file of the sensor model."""
    vehicles: int
    sensors: int
    sessions: int
    readings: int
    """Numbers of vehicles, sensors, sessions and readings."""
    effects: tuple[FleetEffect, ...]
    """What was found, and after that the numbers of the model in which nothing was."""
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
    """Random seed, date and version of the program."""

    @property
    def shown(self) -> tuple[FleetEffect, ...]:
        """What pictures and tables show: the findings, and if nothing was found, the first of the other numbers."""
        return self.effects[: max(self.found, 1)]

    def as_json(self) -> str:
        """All findings as text in JSON."""
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
                    "group": effect.group,
                }


def _digits(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"
