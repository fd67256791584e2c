"""Draw readings one at a time, for emulated sensors: the same distribution and random numbers as `Model.sample`.

For a context of plain values it draws a reading. If the effects only shift, widen or reweight the base mixture, they
are applied to plain numbers, for speed; with additional components or faults `Model.sample` is called with one row.
Both use the same random streams.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from msp_range.arrays import Column
from msp_range.reading_model.kernel import on_grid
from msp_range.reading_model.rows import MixtureRows
from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_sim.effects.base import PATH, TRUE_RANGE, WORD_COLUMNS, Scene
from msp_sim.model.model import Model, applies, shifted_by, shifts_first
from msp_sim.model.streams import RandomStreams


class Sampler:
    """Draws readings of one model, one after the other.

    Parameters
    ----------
    model
        The model with its effects.
    rng
        Source of randomness.

    Examples
    --------
    >>> from msp_sim.model.model import load_model
    >>> sampler = Sampler(load_model("configs/sensors/mb1242.yaml"), np.random.default_rng(1))
    >>> sampler.sample_one({"true_range_cm": 300.0, "air_temperature_c": None}) in range(20, 766)
    True
    """

    def __init__(self, model: Model, rng: np.random.Generator) -> None:
        self._model = model
        self._columns = model.columns
        self._streams = RandomStreams(rng)
        self._plain = model.sensor.reading_model.correlation == 0.0 and not any(
            {"component", "code"} & set(effect.effect.channels) or "run" in effect.effect.requires
            for effect in model.effects
        )

    def sample_one(self, context: Mapping[str, Any]) -> float:
        """Draw one reading [cm].

        Parameters
        ----------
        context
            Values by column; None, NaN or "" if unknown. An unknown true range means that there is no echo.
        """
        if self._plain:
            return self._draw(context)
        columns = {name: _column(name, context.get(name)) for name in self._columns}
        if PATH in context:
            columns[PATH] = context[PATH]
        return float(self._model.sample(columns, self._streams)[0])

    def _draw(self, context: Mapping[str, Any]) -> float:
        base = self._model.base
        range_cm = context.get(TRUE_RANGE)
        centre_cm = math.nan if range_cm is None else base.calibration.forward(float(range_cm))
        sigma_cm, (hit, short, missed, random) = base.sigma_cm(centre_cm), base.log_weights(centre_cm)
        if self._model.effects:
            scene = Scene(self._model.sensor, context)
            for effect in shifts_first(self._model.effects):
                if not applies(scene, effect):
                    continue
                change = effect.effect.apply(scene, effect.values)
                centre_cm += change.bias_cm or 0.0
                scene = shifted_by(scene, True, change)
                sigma_cm *= math.exp(change.log_spread or 0.0)
                short += change.log_odds_short or 0.0
                missed += change.log_odds_missed or 0.0
                random += change.log_odds_random or 0.0
        return self._reading_cm(centre_cm, sigma_cm, (hit, short, missed, random))

    def _reading_cm(self, centre_cm: float, sigma_cm: float, log_weights: tuple[float, float, float, float]) -> float:
        base, streams = self._model.base, self._streams
        parameters = base.parameters
        normal, kind, place = streams["hit"].standard_normal(), streams["kind"].random(), streams["place"].random()
        is_saturated = streams["saturated"].random() < parameters.saturated_fraction
        hit, *others = map(np.exp, log_weights)
        if kind < hit / sum(others, hit) and math.isfinite(centre_cm):
            # As `MixtureRows.draw`, for which arrays of one number take ten times as long.
            drawn_cm = on_grid(centre_cm + sigma_cm * normal, base.resolution_cm)
            reading_cm = float(max(min(drawn_cm, base.maximum_cm), base.minimum_cm))
        else:
            row = MixtureRows(
                np.array([centre_cm]),
                sigma_cm,
                log_weights,
                parameters.short_rate_per_m,
                parameters.saturated_fraction,
                base.minimum_cm,
                base.maximum_cm,
                base.resolution_cm,
            )
            reading_cm = float(row.draw(np.array([normal]), np.array([kind]), np.array([place]))[0])
        return SATURATED_CM if reading_cm == base.maximum_cm and is_saturated else reading_cm


def _column(name: str, value: Any) -> Column:
    if name in WORD_COLUMNS or isinstance(value, str):
        return np.array(["" if value is None else value])
    return np.array([value], dtype=np.float64)
