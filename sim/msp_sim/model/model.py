"""A reading model with effects, made from a sensor model file: it draws readings and gives their log probabilities.

The simulator draws from the same object with which the gap workflow computes likelihoods, so an effect is simulated
exactly as it was found. Contexts are columns by name, those of the CSV form. An effect does nothing on rows in which a
column that it requires is unknown.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from msp_range.arrays import Array, Column
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.yaml_file import ConfigError, suggest
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import (
    PATH,
    REFERENCE,
    REFERENCE_STD,
    TRUE_RANGE,
    WORD_COLUMNS,
    Contribution,
    Effect,
    Scene,
)
from msp_sim.effects.curve import CURVE, MAX_VALUE, Knots, Ripple, curve
from msp_sim.effects.own import find_effect
from msp_sim.effects.path import with_path
from msp_sim.model.history import HISTORY_COLUMNS, History
from msp_sim.model.rows import AddedComponent, AppliedFault, ModelRows, RunOffset
from msp_sim.model.streams import RandomStreams

CHUNK = 1 << 16
"""Rows processed at a time, so that the arrays fit into a processor's cache. Affects speed only."""
LARGEST_SHARE = 1.0 - 1e-12
"""Largest share of a component, so that its odds stay finite."""


@dataclass(frozen=True)
class Term:
    """An effect with values of its parameters, and the sensor, run or target to which it applies."""

    effect: Effect
    values: Mapping[str, float]
    of: str | None = None
    shape: tuple[str, tuple[str, ...], tuple[Knots, ...]] | None = None
    """For an effect that is a curve: its channel, variables and knots."""
    is_added: bool = False
    """Whether it was added to the model by which the true range was estimated (see `Scene.about_run_mean`)."""

    @property
    def stream(self) -> str:
        """Name of the term; it also selects its random stream."""
        if self.shape is not None:
            ripple = self.shape[2][0]
            what = f"ripple of {ripple.period:g}" if isinstance(ripple, Ripple) else self.effect.name
            return f"{what} of {self.shape[0]} over {' and '.join(self.shape[1])}"
        return self.effect.name if self.of is None else f"{self.effect.name} of {self.of}"

    def having(self, values: Mapping[str, float]) -> "Term":
        """A copy with other values of some of its parameters."""
        return replace(self, values={**self.values, **values})

    def change(self, scene: Scene) -> Contribution:
        """Contribution of the effect; NaN, without a warning, for contexts that make no sense."""
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            change = self.effect.apply(scene, self.values)
            if change.bias_cm is None or not self.is_added:
                return change
            return change._replace(bias_cm=scene.about_run_mean(change.bias_cm))


@dataclass(frozen=True)
class Model:
    """The base mixture of a sensor with effects.

    Examples
    --------
    >>> sensor = load_sensor_model("configs/sensors/mb1242.yaml").model_copy(update={"effects": ()})
    >>> model = Model.of(sensor).adding("range_scale", scale_pct=1.0)
    >>> contexts = {"true_range_cm": np.full(3, 300.0)}
    >>> print(np.exp(model.log_prob([300.0, 303.0, 306.0], contexts)).round(3))
    [0.061 0.195 0.061]
    """

    sensor: SensorModel
    effects: tuple[Term, ...] = ()

    @classmethod
    def of(cls, sensor: SensorModel) -> "Model":
        """The model that a sensor model file describes.

        If the file says that a canted sensor reads the slant range, that effect is added.

        Raises
        ------
        ConfigError
            An entry of ``effects`` is not in the catalogue, its parameters are invalid, or it acts on whole centimetres
            and the sensor's resolution is another.
        """
        effects = [_entry(entry, f"effects[{i}]") for i, entry in enumerate(sensor.effects)]
        if sensor.oblique_reading == "slant" and all(effect.effect.name != "slant_range" for effect in effects):
            effects.append(make_term("slant_range", None, {"share": 1.0}))
        for i, effect in enumerate(effects):
            if "code" in effect.effect.channels and not effect.effect.happens_to(sensor):
                step_cm = sensor.resolution_cm
                raise ConfigError(
                    f"effects[{i}].name: {effect.effect.name} acts on bytes of whole centimetres, and resolution_cm is "
                    f"{step_cm:g}"
                )
        return cls(sensor, tuple(effects))

    def with_step(self, step_cm: float) -> "Model":
        """A copy for readings in another step [cm]."""
        if step_cm == self.sensor.resolution_cm:
            return self
        content = self.sensor.model_dump() | {"resolution_cm": step_cm}
        return replace(self, sensor=SensorModel.model_validate(content))

    def adding(self, name: str, of: str | None = None, **values: float) -> "Model":
        """A copy with one more effect of the catalogue; omitted shape parameters have their defaults."""
        return replace(self, effects=(*self.effects, make_term(name, of, values)))

    def added_from(self, given: int) -> "Model":
        """A copy in which the effects from this index on count as added to a given model."""
        effects = (replace(effect, is_added=i >= given) for i, effect in enumerate(self.effects))
        return replace(self, effects=tuple(effects))

    @cached_property
    def base(self) -> ReadingModel:
        """The base mixture."""
        return ReadingModel.of(self.sensor)

    @property
    def columns(self) -> frozenset[str]:
        """Context columns that the model uses."""
        history = HISTORY_COLUMNS if self.sensor.reading_model.correlation > 0.0 else ()
        return frozenset({TRUE_RANGE, REFERENCE_STD, *history}).union(
            *(effect.effect.columns for effect in self.effects)
        )

    def sample(self, contexts: Mapping[str, Any], rng: np.random.Generator | RandomStreams) -> Array:
        """Draw one reading for each context.

        Parameters
        ----------
        contexts
            Columns of length n by name; ``true_range_cm`` is required, NaN if there is no echo. Where
            ``true_range_std_cm`` is known, the true range has a normal error with that standard deviation, which
            widens the hits.
        rng
            A generator, or random streams, which continue from their present state.

        Returns
        -------
        ndarray, shape (n,)
            Readings [cm], multiples of the sensor's resolution.

        Raises
        ------
        ValueError
            ``true_range_cm`` is missing, or columns differ in length.
        """
        streams = rng if isinstance(rng, RandomStreams) else RandomStreams(rng)
        return np.concatenate([rows.sample(streams) for _, rows in self.chunks(contexts)] or [np.zeros(0)])

    def log_prob(self, reading_cm: ArrayLike, contexts: Mapping[str, Any]) -> Array:
        """Natural logarithm of each reading's probability given its context.

        Parameters
        ----------
        reading_cm
            Readings [cm], shape (n,).
        contexts
            As for `sample`.

        Returns
        -------
        ndarray, shape (n,)
            log p; -inf for impossible readings.

        Raises
        ------
        ValueError
            As for `sample`, or the readings are not as many as the contexts.
        """
        reading = np.asarray(reading_cm, dtype=np.float64)
        if TRUE_RANGE in contexts and np.shape(contexts[TRUE_RANGE]) != reading.shape:
            shape = np.shape(contexts[TRUE_RANGE])
            raise ValueError(
                f"found readings of shape {reading.shape} and {TRUE_RANGE} of shape {shape}, expected the same"
            )
        return np.concatenate([rows.log_prob(reading[part]) for part, rows in self.chunks(contexts)] or [np.zeros(0)])

    def rows(self, contexts: Mapping[str, Any]) -> ModelRows:
        """The distribution of the reading for each context, all at once; use `chunks` for many contexts."""
        return self._rows(self._columns(contexts))

    def chunks(self, contexts: Mapping[str, Any]) -> Iterator[tuple[slice, ModelRows]]:
        """The distributions in parts of `CHUNK` rows, each with its slice."""
        columns = self._columns(contexts)
        size = columns[TRUE_RANGE].size
        for start in range(0, size, CHUNK):
            part = slice(start, min(start + CHUNK, size))
            yield part, self._rows({name: column[part] for name, column in columns.items()})

    def _columns(self, contexts: Mapping[str, Any]) -> dict[str, Column]:
        # With them the scene knows where the reference leaves the offset of a run open.
        about_runs = {REFERENCE, "run"} if REFERENCE in contexts else set()
        columns = {name: _column(name, contexts[name]) for name in self.columns | about_runs if name in contexts}
        if TRUE_RANGE not in columns:
            raise ValueError(f"found the context columns {sorted(contexts)}, expected {TRUE_RANGE!r} among them")
        if any(effect.effect.is_shift for effect in self.effects):
            columns |= {name: column for name, column in with_path(contexts).items() if name == PATH}
        sizes = {name: column.size for name, column in columns.items()}
        if len(set(sizes.values())) > 1:
            raise ValueError(f"found context columns of different lengths: {sizes}")
        return columns

    def _rows(self, columns: Mapping[str, Column]) -> ModelRows:
        """The base mixture for these columns, changed by each effect."""
        scene = Scene(self.sensor, columns)
        return apply_terms(base_rows(self, scene), scene, self.effects)


def base_rows(model: Model, scene: Scene) -> ModelRows:
    """The base mixture for a scene, without effects."""
    base = vars(model.base.rows(scene.range_cm))
    parameters = model.sensor.reading_model
    history = None
    if parameters.correlation > 0.0:
        history = history_of(scene, parameters.correlation, parameters.correlation_spacing_s)
    own_cm = np.broadcast_to(base["sigma_cm"], base["centre_cm"].shape)
    known = scene.known(REFERENCE_STD)
    if known is False:
        return ModelRows(**base | {"sigma_cm": own_cm}, history=history)
    reference_cm2 = np.asarray(np.where(known, scene[REFERENCE_STD], 0.0), dtype=np.float64) ** 2
    sigma_cm = np.sqrt(own_cm**2 + reference_cm2)
    return ModelRows(**base | {"sigma_cm": sigma_cm}, history=history, reference_cm2=reference_cm2)


def history_of(scene: Scene, correlation: float, spacing_s: float) -> History:
    """The history of a scene's readings: which one came before which."""
    kept = scene.kept(HISTORY_COLUMNS)
    if ("history", spacing_s) not in kept:
        columns = {name: scene[name] for name in HISTORY_COLUMNS if name in scene}
        kept["history", spacing_s] = History.of(columns, int(np.size(scene.range_cm)), correlation, spacing_s)
    history: History = kept["history", spacing_s]
    return replace(history, correlation=correlation)


def apply_terms(rows: ModelRows, scene: Scene, effects: Iterable[Term]) -> ModelRows:
    """Rows changed by the contribution of each of these terms."""
    centre_cm, log_spread = rows.centre_cm, np.zeros(())
    logs: list[Any] = list(rows.log_weights)
    added, faults, offsets = list(rows.added), list(rows.faults), list(rows.run_offsets)
    known_offsets = len(offsets)
    for effect in shifts_first(effects):
        known = applies(scene, effect)
        if known is False:
            continue
        change = effect.change(scene)
        if change.bias_cm is not None:
            centre_cm = centre_cm + _where(known, change.bias_cm)
        scene = shifted_by(scene, known, change)
        if change.log_spread is not None:
            log_spread = log_spread + _where(known, change.log_spread)
        if change.run_offset_cm is not None:
            offsets.append(RunOffset(change.run_offset_cm, np.where(known, scene["run"], ""), effect.stream))
        odds = (change.log_odds_short, change.log_odds_missed, change.log_odds_random)
        for i, log_odds in enumerate(odds, start=1):
            if log_odds is not None:
                logs[i] = logs[i] + _where(known, log_odds)
        if change.component is not None:
            share = np.clip(_where(known, change.share), 0.0, LARGEST_SHARE)
            added.append(AddedComponent(share / (1.0 - share), change.component, effect.stream))
        if change.fault is not None:
            faults.append(AppliedFault(_where(known, change.fault_share), change.fault, effect.stream))
    sigma_cm = rows.wider(np.exp(log_spread)).sigma_cm if np.any(log_spread) else rows.sigma_cm
    for deviation_cm, runs, _ in offsets[known_offsets:]:
        sigma_cm = np.sqrt(sigma_cm**2 + np.where(runs != "", deviation_cm**2, 0.0))
    return replace(
        rows,
        centre_cm=centre_cm,
        sigma_cm=sigma_cm,
        log_weights=(logs[0], logs[1], logs[2], logs[3]),
        added=tuple(added),
        faults=tuple(sorted(faults, key=lambda faulty: faulty.fault.order)),
        run_offsets=tuple(offsets),
    )


def shifted(scene: Scene, effects: Iterable[Term]) -> Scene:
    """The scene that the readings show, shifted in time by the effects that do that."""
    for effect in effects:
        known = effect.effect.is_shift and applies(scene, effect)
        if known is not False:
            scene = shifted_by(scene, known, effect.change(scene))
    return scene


def shifts_first(effects: Iterable[Term]) -> list[Term]:
    """The effects, those first that shift the scene in time for the others."""
    return sorted(effects, key=lambda each: not each.effect.is_shift)


def shifted_by(scene: Scene, known: Any, change: Contribution) -> Scene:
    """The scene for later effects, after one with this change in the rows where its columns are known."""
    return scene if change.ago_s is None else scene.at(_where(known, change.ago_s))


def applies(scene: Scene, term: Term) -> Any:
    """Rows on which a term's required columns are known: True or False for all rows, or an array."""
    known: Any = True
    for column in term.effect.requires:
        here = scene.known(column)
        if here is False:
            return False
        known = here if known is True else known & here
    if term.effect.per is not None:
        if term.effect.per not in scene:
            return False
        known = known & (scene[term.effect.per] == term.of)
    return known


def load_model(path: Path | str) -> Model:
    """Read a sensor model file with its effects.

    Raises
    ------
    ConfigError
        The file cannot be read, or a value is invalid.
    """
    sensor = load_sensor_model(path)
    try:
        return Model.of(sensor)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def make_term(name: str, of: str | None, values: Mapping[str, float], place: str = "effect") -> Term:
    """Make a term from an effect of the catalogue and values.

    Raises
    ------
    ConfigError
        There is no such effect, a parameter is missing, unknown or out of its bounds, or ``of`` is missing.
    """
    effect = find_effect(name)
    if effect is None:
        near = suggest(name, CATALOGUE)
        raise ConfigError(
            f"{place}.name: found {name!r}, expected one that 'msp-lab effects' lists, or one of your own file: "
            f"--effects FILE.py.{near}"
        )
    if (of is None) != (effect.per is None):
        expected = (
            f"the name of a {effect.per}, since {name} applies to one of them"
            if effect.per
            else f"nothing: {name} applies to all readings"
        )
        raise ConfigError(f"{place}.of: found {'nothing' if of is None else repr(of)}, expected {expected}")
    known = {parameter.name: parameter for parameter in effect.parameters}
    for key, value in values.items():
        if key not in known:
            raise ConfigError(f"{place}.parameters.{key}: unknown; {name} has {', '.join(known)}.{suggest(key, known)}")
        low, high, unit = known[key].low, known[key].high, known[key].unit
        if not low <= value <= high:
            raise ConfigError(f"{place}.parameters.{key}: found {value:g}, expected {low:g} to {high:g} [{unit}]")
    for key, parameter in known.items():
        if key not in values and parameter.neutral is not None:
            raise ConfigError(f"{place}.parameters.{key}: this key is missing; expected {parameter.meaning}")
    return Term(effect, {**effect.neutral_values(), **values}, of)


def make_curve_term(
    channel: Any,
    variables: Any,
    knots: Any,
    values: Any,
    place: str = "curve",
) -> Term:
    """Make a term from a curve and its values.

    Raises
    ------
    ConfigError
        There is no such channel, knots do not increase, or there are not as many values as knots.
    """
    if channel not in MAX_VALUE:
        raise ConfigError(f"{place}.channel: found {channel!r}, expected one of {', '.join(MAX_VALUE)}")
    if not isinstance(variables, list | tuple) or not 1 <= len(variables) <= 2:
        raise ConfigError(f"{place}.variables: found {variables!r}, expected one or two context columns")
    if isinstance(knots, list | tuple):
        knots = [Ripple(knot["period"]) if _is_ripple(knot) else knot for knot in knots]
    if not isinstance(knots, list | tuple) or len(knots) != len(variables) or not all(map(_are_knots, knots)):
        raise ConfigError(
            f"{place}.knots: found {knots!r}, expected for each variable two or more increasing numbers, or words, "
            "or a mapping with the 'period' of a ripple"
        )
    count = int(np.prod([len(knot) for knot in knots]))
    if (
        not isinstance(values, list | tuple)
        or len(values) != count
        or not all(_is_number(each) and abs(each) <= MAX_VALUE[channel] for each in values)
    ):
        raise ConfigError(
            f"{place}.values: found {values!r}, expected {count} numbers within +-{MAX_VALUE[channel]:g}, one per knot"
        )
    places = tuple(knot if isinstance(knot, Ripple) else tuple(knot) for knot in knots)
    shape = (str(channel), tuple(str(variable) for variable in variables), places)
    effect = curve(channel, shape[1], shape[2])
    return Term(effect, {f"value_{i}": float(value) for i, value in enumerate(values)}, None, shape)


def _is_ripple(places: Any) -> bool:
    if not isinstance(places, dict) or set(places) != {"period"}:
        return False
    period = places["period"]
    return _is_number(period) and 0.0 < period < np.inf


def _are_knots(places: Any) -> bool:
    if isinstance(places, Ripple):
        return True
    if not isinstance(places, list | tuple) or not places:
        return False
    if all(isinstance(place, str) for place in places):
        return True
    return len(places) > 1 and all(map(_is_number, places)) and bool(np.all(np.diff(places) > 0.0))


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _entry(entry: Mapping[str, Any], place: str) -> Term:
    """An entry of a model file's ``effects``."""
    is_curve = entry.get("name") == CURVE
    own_keys = ("channel", "variables", "knots", "values") if is_curve else ("of", "parameters")
    keys = ("name", *own_keys, "evidence")
    for key in entry:
        if key not in keys:
            raise ConfigError(f"{place}.{key}: unknown key.{suggest(key, keys)} Known keys here: {', '.join(keys)}")
    if is_curve:
        channel, variables, knots, values = map(entry.get, own_keys)
        return make_curve_term(channel, variables, knots, values, place)
    parameters = entry.get("parameters", {})
    if not isinstance(parameters, dict):
        raise ConfigError(f"{place}.parameters: found {parameters!r}, expected names with numbers")
    values = {}
    for key, found in parameters.items():
        value = found.get("value") if isinstance(found, dict) else found
        if not _is_number(value):
            raise ConfigError(
                f"{place}.parameters.{key}: found {found!r}, expected a number, or a mapping with its 'value'"
            )
        values[str(key)] = float(value)
    return make_term(str(entry.get("name")), entry.get("of"), values, place)


def _where(known: Any, contribution: Any) -> Any:
    return contribution if known is True else np.where(known, contribution, 0.0)


def _column(name: str, values: Any) -> Column:
    column = np.asarray(values)
    # Columns of one's own may hold words, too.
    if column.dtype.kind != "U" and name not in WORD_COLUMNS:
        column = column.astype(np.float64, copy=False)
    if column.ndim != 1:
        raise ValueError(f"found {name} of shape {column.shape}, expected one dimension")
    return column
