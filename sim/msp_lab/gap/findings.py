"""What the gap workflow found, as plain values: the content of ``gap.json``.

The steps of the workflow fill these records in; the terminal, the report and other programs read them. Nothing here
computes or decides. A number that is not known is None.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from msp_sim.page.text import capitalised

Verdict: TypeAlias = Literal[
    "nothing missing", "undecided", "absorbed", "explained", "improved", "partly explained", "unexplained"
]
Kind: TypeAlias = Literal["named", "indistinguishable", "suggested"]
LastStep: TypeAlias = Literal["compare", "name", "add", "show"]


@dataclass(frozen=True)
class Measure:
    """One measure of the gap, on held-out readings."""

    before: float | None
    after: float | None = None
    """Value with the given model, and with what was added."""
    noise_floor: float | None = None
    """What 95 of 100 tables that the extended model itself draws stay below: a gap that is not there."""
    low: float | None = None
    high: float | None = None
    """95 % interval of `after`; its errors are those of whole runs."""

    @property
    def was_beyond_floor(self) -> bool:
        """Whether the given model differs by more than random variation gives, as far as that is known."""
        return self._is_beyond_floor(self.before)

    @property
    def is_beyond_floor(self) -> bool:
        """Whether more is left than random variation gives, as far as that is known."""
        return self._is_beyond_floor(self.after)

    @property
    def has_grown(self) -> bool:
        """Whether what is left is more than there was before, by more than its error."""
        left = self.after if self.low is None else self.low
        return None not in (left, self.before) and (left or 0.0) > (self.before or 0.0)

    def _is_beyond_floor(self, value: float | None) -> bool:
        return None not in (value, self.noise_floor) and (value or 0.0) > (self.noise_floor or 0.0)


@dataclass(frozen=True)
class OddsMeasures:
    """How far the odds of each class of outlier are off: 1 is right, 2 is twice or half as often as in the model."""

    short: Measure
    missed: Measure
    random: Measure
    """Readings nearer than the surface; without an echo; anything else that is no hit."""
    code: Measure
    """Readings that are no distance: outside of the sensor's limits, 255 for a missed echo, undeclared point masses."""


@dataclass(frozen=True)
class Gap:
    """The gap in its four measures."""

    nats_per_reading: Measure
    """What a model that is free in each slice of context would gain per reading, less what it gains by random variation
    [nat]."""
    bias_cm: Measure
    """Root mean square over the slices of the bias of the hits, less what random variation adds [cm]."""
    spread_ratio: Measure
    """By which factor the spread of the hits is off, root mean square over the slices of its logarithm."""
    odds: OddsMeasures
    """How far the odds of the outliers are off."""

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

    def may_be(self, value: float) -> bool:
        """Whether a value is in the interval; False where that is not known."""
        return self.low is not None and self.high is not None and self.low <= value <= self.high


@dataclass(frozen=True)
class Alternative:
    """Another name for the same gap."""

    name: str
    """Effect of the catalogue; of offsets of runs also a column that is the same all over each run."""
    loss_nats: float
    """By how much its best fit is worse, in log-likelihood of the readings that are refitted [nat]."""
    correlation: float | None = None
    """Correlation of both effects' scores."""
    of: str | None = None
    """The sensor, run or target that it is of."""


@dataclass(frozen=True)
class FoundEffect:
    """An effect that is missing from the model."""

    name: str
    """Name as in a model file."""
    verdict: Kind
    """named: no other effect of the catalogue does as well; indistinguishable: the alternatives do; suggested: it is no
    finding, for the reason in `doubt`."""
    parameters: Mapping[str, FittedValue]
    """Parameters by name, from all runs."""
    gain_nats: float | None
    """Gain in log score per reading, each reading scored by a fit that it had no part in [nat]."""
    z: float | None
    """That gain over its standard error by runs."""
    alternatives: tuple[Alternative, ...] = ()
    """Other names that these data cannot tell from it."""
    experiment: str = ""
    """What would tell them apart, or what would show it alone."""
    of: str | None = None
    """The sensor, run or target that it is of."""
    doubt: str = ""
    """Why it is only suggested."""
    plain: str = ""
    """What was found, in words for a pilot."""
    splits_agree: float | None = None
    """In which share of the splits of the runs it holds: each part scores better for it by a fit of the others."""
    in_model: bool = False
    """Whether the given model has it too: the parameters are what comes on top."""
    where: str = ""
    """Where it changes readings by more than their noise, in words; empty: nowhere, or that was not looked at yet."""


@dataclass(frozen=True)
class UnknownEffect:
    """Something that no effect of the catalogue explains."""

    channel: str
    """What it changes: bias, spread, short, missed or random."""
    variables: tuple[str, ...]
    """Context columns that it depends on."""
    formula: str
    """A short formula in the variables."""
    gain_nats: float | None
    """As of a `FoundEffect` [nat]."""
    curve: tuple[tuple[float, float, float, float], ...] = ()
    """Points of its curve, for drawing: value of the variable, effect, ends of its band."""
    likely_causes: tuple[tuple[str, str], ...] = ()
    """Effects of the catalogue that depend on the same, and the one column that each of them lacks."""
    plain: str = ""
    """What was found, in words for a pilot."""
    period: float | None = None
    """Period of a ripple, in the unit of its variable; None: it is a curve."""
    splits_agree: float | None = None
    z: float | None = None
    where: str = ""
    """As of a `FoundEffect`."""


OF_READINGS = ("resolution", "code")
"""Names of findings that are of the data's form: the step in which readings are compared, and codes."""


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
class RunScatter:
    """Runs, or readings inside them, differ by more than the extended model says, and nothing that was found says why.

    What the model itself says of runs that differ counts as said.
    """

    deviation_cm: float
    """Standard deviation of the means of runs, or of parts of runs, beyond random variation [cm]."""
    inside_runs: bool
    """Whether readings wander inside runs; if not, runs differ from each other."""


@dataclass(frozen=True)
class PossibleCause:
    """An effect that a number of the base may have absorbed, because a column did not vary."""

    number: str
    """Number of the base, as in `CalibrationFinding.name`."""
    effect: str
    column: str
    """Effect of the catalogue, and the column that would show it."""
    recorded: bool
    """The column is there and hardly varies; otherwise it is not recorded."""
    experiment: str
    """An experiment that shows the effect alone."""


@dataclass(frozen=True)
class ReadingAge:
    """How old a reading is where it is late and also repeated."""

    latency_s: float
    """Age of a new value [s]."""
    mean_hold_s: float
    """Mean time since the value was new [s]."""

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
    """A part of the readings, by context."""

    where: str
    """Its context in words, such as ``true_range_cm 120 to 180``."""
    variables: tuple[str, ...]
    """Context columns that it is made of."""
    readings: int
    """How many readings it has."""
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
    """How the readings differ from the model, and standard errors, by runs where readings depend."""
    nats: float | None
    """What a free model would gain per reading here, less random variation [nat]."""
    channel: str
    """The measure that differs most."""
    z: float | None
    p_value: float | None
    """Z and p-value of that measure; the p-value is corrected for the number of slices and measures."""
    after: Mapping[str, float | None] = field(default_factory=dict)
    """The same numbers with the extended model, by name, as far as they were taken."""
    by: tuple[str, ...] = ()
    """What was found and changes readings here by more than their noise."""
    differs: bool = False
    """Whether readings and given model differ here: by p-value, and once something was found by what it changes."""


def error_name(number: str) -> str:
    """Field of a `Slice` with the standard error of a number, whose field is given."""
    return "bias_se_cm" if number == "bias_cm" else f"{number}_se"


@dataclass(frozen=True)
class PathStep:
    """A step of the selection path: the gap on the held-out readings after one more change."""

    added: str
    """What was added last; empty: the given model."""
    nats_per_reading: float | None
    """As in `Gap`, after this step."""
    log_score: float | None
    """Mean log probability of a held-out reading [nat]."""


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
    """The content of ``gap.json``."""

    verdict: Verdict | None
    """None until it is known."""
    rows: int
    runs: int
    """Readings that were compared, and in how many runs."""
    gap: Gap | None = None
    effects: tuple[FoundEffect, ...] = ()
    unknown: tuple[UnknownEffect, ...] = ()
    calibration: tuple[CalibrationFinding, ...] = ()
    not_testable: tuple[NotTestable, ...] = ()
    slices: tuple[Slice, ...] = ()
    """What was found."""
    seconds: float = 0.0
    """How long it took."""
    sentence: str = ""
    """The decision, in one sentence for a pilot."""
    random_share: float | None = None
    """How often random variation alone shows as much as the decision rests on, 0 to 1."""
    how_sure: str = ""
    """That in words."""
    next_step: str = ""
    """What to do next, by the decision and how sure it is."""
    summary: tuple[str, ...] = ()
    """At most five lines: how sure, what to do next, and the numbers."""
    causes: tuple[PossibleCause, ...] = ()
    """What calibration may have absorbed."""
    run_scatter: RunScatter | None = None
    """How far runs differ, or readings wander, next to what was found; None: not at all, or there is no run."""
    age: ReadingAge | None = None
    """Age of a reading that is late and also repeated; None where it is not both."""
    detectable: str = ""
    """The smallest effects that these data would have shown, in words."""
    selection_path: tuple[PathStep, ...] = ()
    """The gap after each step from the given model to the extended one."""
    training_runs: tuple[str, ...] = ()
    held_out_runs: tuple[str, ...] = ()
    """Halves of the runs: the gap is measured on the held-out ones, what is left of it with a fit of the others."""
    splits: int = 0
    """How many splits of the runs validate what is named."""
    p_value: float | None = None
    """p-value of the hypothesis that nothing is missing, by the first test of all effects at once."""
    sources: tuple[ReadingsFile, ...] = ()
    settings: Settings = Settings("")
    messages: tuple[str, ...] = ()
    date: str = ""
    """Which data, how, what was noticed about them, and when."""
    model_sha256: str = ""
    version: str = ""
    """Hash of the given model's file, and the version of this program."""

    @property
    def nats(self) -> Measure:
        """The gap per reading; nothing is known of it where nothing was compared."""
        return Measure(None) if self.gap is None else self.gap.nats_per_reading

    @property
    def refitted(self) -> tuple[CalibrationFinding, ...]:
        """The numbers of the base model that are others; the readings' step and codes are none."""
        return tuple(number for number in self.calibration if number.name not in OF_READINGS)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was noticed about the readings, with the step in which they are compared and the codes set aside; a
        sentence each."""
        found = (f"{capitalised(each.finding)}." for each in self.calibration if each.name in OF_READINGS)
        return (*self.messages, *found)

    @property
    def confirmed(self) -> tuple[FoundEffect, ...]:
        """The effects that are findings; what is only suggested is none."""
        return tuple(effect for effect in self.effects if effect.verdict != "suggested")
