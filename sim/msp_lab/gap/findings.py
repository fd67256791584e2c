"""What the gap workflow found, as plain values: the content of ``gap.json``.

The steps of the workflow fill these records in; the terminal, the report and other programs read them. Nothing here
computes or decides. A number that is not known is None.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

Verdict: TypeAlias = Literal["nothing missing", "absorbed", "explained", "improved", "partly explained", "unexplained"]
Kind: TypeAlias = Literal["named", "indistinguishable", "suggested"]
LastStep: TypeAlias = Literal["compare", "name", "add", "show"]


@dataclass(frozen=True)
class Measure:
    """One measure of the gap, on held-out readings.

    Attributes
    ----------
    before, after
        With the given model, and with what was added.
    noise_floor
        What 95 of 100 tables that the extended model itself draws stay below: a gap that is not there.
    low, high
        95 % interval of `after`; its errors are those of whole runs.
    """

    before: float | None
    after: float | None = None
    noise_floor: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class OddsMeasures:
    """How far the odds of each class of outlier are off: 1 is right, 2 is twice or half as often as in the model.

    Attributes
    ----------
    short, missed, random
        Nearer than the surface; no echo; anything else that is no hit.
    code
        Readings that are no distance: outside of the sensor's limits, 255 for a missed echo, undeclared point masses.
    """

    short: Measure
    missed: Measure
    random: Measure
    code: Measure


@dataclass(frozen=True)
class Gap:
    """The gap in its four measures.

    Attributes
    ----------
    nats_per_reading
        What a model that is free in each slice of context would gain per reading, less what it gains by random
        variation [nat].
    bias_cm
        Root mean square over the slices of the bias of the hits, less what random variation adds [cm].
    spread_ratio
        By which factor the spread of the hits is off, root mean square over the slices of its logarithm.
    odds
        Of the outliers.
    """

    nats_per_reading: Measure
    bias_cm: Measure
    spread_ratio: Measure
    odds: OddsMeasures

    @property
    def measures(self) -> Mapping[str, Measure]:
        """Nats, bias, spread and the odds of each class of outlier by name, as in model files."""
        return {
            "nats_per_reading": self.nats_per_reading,
            "bias_cm": self.bias_cm,
            "spread_ratio": self.spread_ratio,
            "odds_short": self.odds.short,
            "odds_missed": self.odds.missed,
            "odds_random": self.odds.random,
        }


@dataclass(frozen=True)
class FittedValue:
    """A fitted parameter with its 95 % interval."""

    value: float
    low: float | None
    high: float | None
    unit: str


@dataclass(frozen=True)
class Alternative:
    """Another name for the same gap.

    Attributes
    ----------
    name
        Effect of the catalogue.
    loss_nats
        By how much its best fit is worse, in log-likelihood of the readings that are refitted [nat].
    correlation
        Of both effects' scores.
    of
        The sensor, run or target that it is of.
    """

    name: str
    loss_nats: float
    correlation: float | None = None
    of: str | None = None


@dataclass(frozen=True)
class FoundEffect:
    """An effect that is missing from the model.

    Attributes
    ----------
    name, of
        As in a model file; `of` is the sensor, run or target that it is of.
    verdict
        named: no other effect of the catalogue does as well; indistinguishable: the alternatives do;
        suggested: it is no finding, for the reason in `doubt`.
    parameters
        By name, from all runs.
    gain_nats
        Gain in log score per reading, each reading scored by a fit that it had no part in [nat].
    z
        That gain over its standard error by runs.
    splits_agree
        In which share of the splits of the runs it holds: each part scores better for it by a fit of the others.
    alternatives
        Other names that these data cannot tell from it.
    experiment
        What would tell them apart, or what would show it alone.
    doubt
        Why it is only suggested.
    plain
        What was found, in words for a pilot.
    next_step
        What to do next.
    in_model
        Whether the given model has it too: the parameters are what comes on top.
    """

    name: str
    verdict: Kind
    parameters: Mapping[str, FittedValue]
    gain_nats: float | None
    z: float | None
    alternatives: tuple[Alternative, ...] = ()
    experiment: str = ""
    of: str | None = None
    doubt: str = ""
    plain: str = ""
    next_step: str = ""
    splits_agree: float | None = None
    in_model: bool = False


@dataclass(frozen=True)
class UnknownEffect:
    """Something that no effect of the catalogue explains.

    Attributes
    ----------
    channel
        What it changes: bias, spread, short, missed or random.
    variables
        Context columns that it depends on.
    formula
        Short, in the variables.
    gain_nats, splits_agree
        As of a `FoundEffect`.
    curve
        Points of its curve, for drawing: value of the variable, effect, ends of its band.
    likely_causes
        Effects of the catalogue that depend on the same, and the one column that each of them lacks.
    plain
        What was found, in words for a pilot.
    next_step
        What to do next.
    period
        Of a ripple, in the unit of its variable; None: it is a curve.
    """

    channel: str
    variables: tuple[str, ...]
    formula: str
    gain_nats: float | None
    curve: tuple[tuple[float, float, float, float], ...] = ()
    likely_causes: tuple[tuple[str, str], ...] = ()
    plain: str = ""
    next_step: str = ""
    period: float | None = None
    splits_agree: float | None = None


@dataclass(frozen=True)
class CalibrationFinding:
    """Something that belongs to the base model or to the data's form, and is no missing effect."""

    name: str
    finding: str
    before: float | None = None
    after: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class PossibleCause:
    """An effect that a number of the base may have absorbed, because a column did not vary.

    Attributes
    ----------
    number
        Of the base, as in `CalibrationFinding.name`.
    effect, column
        Effect of the catalogue, and the column that would show it.
    recorded
        The column is there and hardly varies; otherwise it is not recorded.
    experiment
        That shows the effect alone.
    """

    number: str
    effect: str
    column: str
    recorded: bool
    experiment: str


@dataclass(frozen=True)
class ReadingAge:
    """How old a reading is where it is late and also repeated.

    Attributes
    ----------
    latency_s
        Age of a new value [s].
    mean_hold_s
        Mean time since the value was new [s].
    """

    latency_s: float
    mean_hold_s: float

    @property
    def total_s(self) -> float:
        """Mean age of a reading [s]."""
        return self.latency_s + self.mean_hold_s


@dataclass(frozen=True)
class NotTestable:
    """An effect that these data cannot show, and the columns to record for it."""

    name: str
    columns: tuple[str, ...]
    why: str = ""


@dataclass(frozen=True)
class Slice:
    """A part of the readings, by context.

    Attributes
    ----------
    where
        In words, such as ``true_range_cm 120 to 180``.
    variables
        Context columns that it is made of.
    readings
        How many.
    bias_cm, log_spread, log_odds_short, log_odds_missed, log_odds_random
        How the readings differ from the model.
    bias_se_cm, log_spread_se, ...
        Standard errors, by runs where readings depend.
    nats
        What a free model would gain per reading here, less random variation [nat].
    channel
        The measure that differs most.
    z, p_value
        Of that; the p-value is corrected for the number of slices and measures.
    after
        The same numbers with the extended model, by name, as far as they were taken.
    """

    where: str
    variables: tuple[str, ...]
    readings: int
    bias_cm: float | None
    bias_se_cm: float | None
    log_spread: float | None
    log_spread_se: float | None
    log_odds_short: float | None
    log_odds_short_se: float | None
    log_odds_missed: float | None
    log_odds_missed_se: float | None
    log_odds_random: float | None
    log_odds_random_se: float | None
    nats: float | None
    channel: str
    z: float | None
    p_value: float | None
    after: Mapping[str, float | None] = field(default_factory=dict)


def error_name(number: str) -> str:
    """Field of a `Slice` with the standard error of a number, whose field is given."""
    return "bias_se_cm" if number == "bias_cm" else f"{number}_se"


@dataclass(frozen=True)
class PathStep:
    """A step of the selection path: the gap on the held-out readings after one more change.

    Attributes
    ----------
    added
        What was added last; empty: the given model.
    nats_per_reading
        As in `Gap`, after this step.
    log_score
        Mean log probability of a held-out reading [nat].
    """

    added: str
    nats_per_reading: float | None
    log_score: float | None


@dataclass(frozen=True)
class ReadingsFile:
    """A file of readings."""

    path: str
    sha256: str
    rows: int


@dataclass(frozen=True)
class Settings:
    """What the user asked for, so that each step can go on from the file of the one before."""

    model: str
    alpha: float = 0.01
    max_effects: int = 6
    seed: int = 1
    run_column: str | None = None
    map: tuple[str, ...] = ()
    of: tuple[str, ...] = ()


@dataclass(frozen=True)
class GapFindings:
    """The content of ``gap.json``.

    Attributes
    ----------
    verdict
        None until it is known.
    sentence
        The findings in one sentence for a pilot.
    summary
        At most five lines with numbers, the last of which says what to do next.
    causes
        What calibration may have absorbed.
    age
        Of a reading that is late and also repeated; None where it is not both.
    rows, runs
        Readings that were compared, and in how many runs.
    gap, effects, unknown, calibration, not_testable, slices
        What was found.
    detectable
        The smallest effects that these data would have shown, in words.
    seconds
        How long it took.
    selection_path
        The gap after each step from the given model to the extended one.
    training_runs, held_out_runs
        Halves of the runs: the gap is measured on the held-out ones, what is left of it with a fit of the others.
    splits
        How many splits of the runs validate what is named.
    p_value
        Of the hypothesis that nothing is missing.
    sources, settings, messages, date
        Which data, how, what was noticed about them, and when.
    model_sha256, version
        Hash of the given model's file, and the version of this program.
    """

    verdict: Verdict | None
    rows: int
    runs: int
    gap: Gap | None = None
    effects: tuple[FoundEffect, ...] = ()
    unknown: tuple[UnknownEffect, ...] = ()
    calibration: tuple[CalibrationFinding, ...] = ()
    not_testable: tuple[NotTestable, ...] = ()
    slices: tuple[Slice, ...] = ()
    seconds: float = 0.0
    sentence: str = ""
    summary: tuple[str, ...] = ()
    causes: tuple[PossibleCause, ...] = ()
    age: ReadingAge | None = None
    detectable: str = ""
    selection_path: tuple[PathStep, ...] = ()
    training_runs: tuple[str, ...] = ()
    held_out_runs: tuple[str, ...] = ()
    splits: int = 0
    p_value: float | None = None
    sources: tuple[ReadingsFile, ...] = ()
    settings: Settings = Settings("")
    messages: tuple[str, ...] = ()
    date: str = ""
    model_sha256: str = ""
    version: str = ""

    @property
    def confirmed(self) -> tuple[FoundEffect, ...]:
        """The effects that are findings; what is only suggested is none."""
        return tuple(each for each in self.effects if each.verdict != "suggested")
