"""A scenario with random parameters: flight number `index` of all that a seed stands for.

A scenario, a seed and an index give a `SampledFlight`, always the same one. `msp-sim monte-carlo` flies many of them,
and `msp-sim fly --sample` any of them again.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from numpy.random import SeedSequence, default_rng
from pydantic import ValidationError

from msp_range.yaml_file import ConfigError, Place, check, with_value
from msp_sim.device.device import Fault
from msp_sim.device.table import emulated_kind
from msp_sim.flight.scenario import ImpossibleFlight, Scenario
from msp_sim.flight.vary import (
    Distribution,
    Factor,
    VarySection,
    default_parameters,
    places,
    value_at,
)

MOST_DRAWS = 100
"""Draws of one flight after which none is expected to be possible: with fewer a scenario close to the ground may end
without a reason, more only delay the message."""


@dataclass(frozen=True)
class SampledFlight:
    """One flight with random parameters."""

    scenario: Scenario
    """The scenario to be flown, with the drawn values in it."""
    seed: int
    """Random seed of the flight itself."""
    values: Mapping[str, Any]
    """What was drawn, by the parameter's path."""
    faults: tuple[Mapping[str, Any], ...]
    """Random faults, as in a scenario's section ``faults``."""
    refused: int
    """Number of draws before it in which the vehicle would have flown into the ground, or longer than the scenario."""

    def text(self, airframe: str) -> str:
        """The scenario as a file, with the airframe file of this name."""
        content = self.scenario.model_dump(exclude={"airframe", "vary"}, exclude_defaults=True, mode="json")
        return yaml.safe_dump({"name": content.pop("name"), "airframe": airframe, **content}, sort_keys=False)


class Sampled:
    """All flights of a scenario whose parameters vary.

    Parameters
    ----------
    scenario
        With its section ``vary``, or without: then `default_parameters` and faults vary.
    source
        Name of its file, for messages.

    Attributes
    ----------
    vary
        What varies.

    Raises
    ------
    ConfigError
        A parameter of ``vary`` is not in the scenario, or cannot have the values of its distribution.

    Examples
    --------
    >>> from msp_sim.flight.scenario import load_scenario
    >>> flights = Sampled(load_scenario("rough_grass"), "rough_grass.yaml")
    >>> first = flights.sample(1, 0)
    >>> first.values == flights.sample(1, 0).values, first.values == flights.sample(1, 1).values
    (True, False)
    """

    def __init__(self, scenario: Scenario, source: str) -> None:
        self.scenario = scenario
        self.vary: VarySection = scenario.vary or _default(scenario)
        self._source = source
        self._plain = scenario.model_dump(exclude={"airframe", "vary"})
        self._places: dict[str, list[Place]] = {}
        for path, variation in self.vary.parameters.items():
            self._find_places(path, variation)
        self._kinds = _kinds_by_sensor(scenario, self.vary.faults.kinds) if self.vary.faults is not None else {}
        if self.vary.faults is not None and not self._kinds:
            raise ConfigError(f"{source}: vary.faults.kinds: no sensor of the airframe can show any of them")

    def sample(self, seed: int, index: int) -> SampledFlight:
        """Draw a flight.

        Raises
        ------
        ConfigError
            None of `MOST_DRAWS` draws can be flown.
        """
        for_flight, for_draws = SeedSequence([seed, index]).spawn(2)
        flight_seed = int(for_flight.generate_state(1, np.uint64)[0])
        generator = default_rng(for_draws)
        reason = ""
        for refused in range(MOST_DRAWS):
            values = {path: variation.draw(generator) for path, variation in self.vary.parameters.items()}
            plain = self._plain
            for path, value in values.items():
                plain = self._with(plain, path, value)
            faults = self.vary.faults.draw(generator, self._kinds, plain["duration_s"]) if self.vary.faults else []
            try:
                scenario = self._scenario({**plain, "faults": [*plain["faults"], *faults]}, self._source)
            except ImpossibleFlight as error:
                reason = str(error)
                continue
            return SampledFlight(scenario, flight_seed, values, tuple(faults), refused)
        raise ConfigError(f"{self._source}: vary: none of {MOST_DRAWS} draws can be flown; the last one: {reason}")

    def _find_places(self, path: str, distribution: Distribution) -> None:
        """Find the places of a parameter, and check that they can have the values of its distribution."""
        key = f"{self._source}: vary.parameters: {path}"
        try:
            found = places(self._plain, path)
        except ValueError as error:
            raise ConfigError(f"{key}: {error}") from None
        if not found:
            raise ConfigError(f"{key}: the list has no elements in this scenario")
        if isinstance(distribution, Factor):
            for place in found:
                own = value_at(self._plain, place)
                if isinstance(own, bool) or not isinstance(own, int | float):
                    raise ConfigError(f"{key}: found {own!r} in the scenario; expected a number that a factor changes")
        self._places[path] = found
        for end in distribution.ends:
            with suppress(ImpossibleFlight):
                self._scenario(self._with(self._plain, path, end), f"{self._source}: vary.parameters")

    def _with(self, plain: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
        """Plain values with a draw of a parameter."""
        is_factor = isinstance(self.vary.parameters[path], Factor)
        for place in self._places[path]:
            plain = with_value(plain, place, value_at(self._plain, place) * value if is_factor else value)
        return plain

    def _scenario(self, plain: dict[str, Any], source: str) -> Scenario:
        """The scenario with these values.

        Raises
        ------
        ImpossibleFlight
            Each value is possible, but the flight is not: into the ground, or longer than the scenario.
        ConfigError
            A value is not possible.
        """
        content = {**plain, "airframe": self.scenario.airframe}
        try:
            return Scenario.model_validate(content)
        except ValidationError as error:
            causes = [problem.get("ctx", {}).get("error") for problem in error.errors(include_url=False)]
        if len(causes) == 1 and isinstance(causes[0], ImpossibleFlight):
            raise causes[0]
        return check(source, Scenario, content, None)


def _kinds_by_sensor(scenario: Scenario, kinds: Sequence[str]) -> dict[str, list[str]]:
    """The kinds of fault that each sensor can show, of those that are wanted; sensors that can show none are left
    out."""
    found: dict[str, list[str]] = {}
    for sensor in scenario.airframe.sensors:
        emulated = emulated_kind(sensor.sensor_model.driver)
        for kind in kinds:
            with suppress(ValueError):
                emulated.check_fault(Fault(kind, 0.0, 1.0))
                found.setdefault(sensor.name, []).append(kind)
    return found


def _default(scenario: Scenario) -> VarySection:
    """What varies if the scenario file does not say it; the track only if there is one."""
    parameters = default_parameters(scenario.ground.surface, has_track=bool(scenario.flight.track.legs))
    return VarySection.model_validate({"parameters": parameters, "faults": {}})
