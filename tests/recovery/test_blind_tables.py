"""A small fixed part of the blind table, and two checks of honesty, by the commands that a user has.

The readings are the blind generator's, which shares nothing with the model or the catalogue; the model is characterised
on flights of the same generator with nothing hidden. ``make blind`` draws many more of these and scores them.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from evaluation.blind.flight import Columns, Regime, contexts, habits
from evaluation.blind.mechanisms import MECHANISMS
from evaluation.blind.run import SENSOR, write
from evaluation.blind.score import Outcome, accepted_names, judge
from evaluation.blind.size import Hidden, stage
from evaluation.blind.sound import Array
from evaluation.blind.tables import CONFOUNDED, ROWS, RUNS, fly_base
from msp_lab.gap.findings import FoundEffect, GapFindings
from msp_lab.gap.findings_file import read_findings
from msp_sim.model.model import load_model
from tests.support.known import known
from tests.support.programs import run
from tests.support.slow import slow

BASE_SEED = 11
NAMES = accepted_names()


@dataclass(frozen=True)
class Flown:
    """Flights with something hidden, or nothing."""

    columns: Columns
    reading_cm: Array
    regime: Regime
    hidden: Hidden


@dataclass(frozen=True)
class Looked:
    """What the workflow reported of them."""

    found: GapFindings
    outcome: Outcome
    folder: Path

    @property
    def effect(self) -> FoundEffect:
        """The only one."""
        (effect,) = self.found.effects
        return effect


Look = Callable[[Flown], Looked]


def flown(seed: int, hidden: Hidden = (), regime: Regime = "iid", twist: str = "") -> Flown:
    """A table as the blind table draws it, with the size of what is hidden in its own unit.

    The same seed gives the same flights with the same noise, whatever is hidden in them.
    """
    context_seed, twist_seed, hiding = np.random.SeedSequence((seed, 1, 0)).spawn(3)
    columns = contexts(np.random.default_rng(context_seed), RUNS, ROWS, regime)
    if twist:
        CONFOUNDED[twist][1](columns, np.random.default_rng(twist_seed))
    flight, reading_cm = stage(columns, habits(regime), hidden, hiding)
    return Flown(flight.columns, reading_cm, regime, hidden)


@pytest.fixture(scope="session")
def base(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Regime], Path]:
    """The model that a user has before anything is hidden: characterised, one a regime."""
    folder = tmp_path_factory.mktemp("bases")

    def of(regime: Regime) -> Path:
        model = folder / f"{regime}.yaml"
        if not model.exists():
            write(folder / f"{regime}.csv", *fly_base(BASE_SEED, regime))
            given = ("--sensor", SENSOR, "--set-up-std-cm", "0.02")
            run("msp-lab characterise", folder / f"{regime}.csv", *given, "--out", model)
        return model

    return of


@pytest.fixture(scope="session")
def look(base: Callable[[Regime], Path], tmp_path_factory: pytest.TempPathFactory) -> Look:
    """Run the workflow on flights."""

    def at(flights: Flown) -> Looked:
        folder = tmp_path_factory.mktemp("table")
        write(folder / "measured.csv", flights.columns, flights.reading_cm)
        run(
            "msp-lab gap",
            folder / "measured.csv",
            "--model",
            base(flights.regime),
            "--out",
            folder / "gap",
            "--until",
            "add",
        )
        gap = json.loads((folder / "gap" / "gap.json").read_text(encoding="utf-8"))
        hidden = [
            {"mechanism": name, "channel": MECHANISMS[name].channel, "variables": MECHANISMS[name].variables}
            for name, _ in flights.hidden
        ]
        return Looked(read_findings(folder / "gap"), judge({"hidden": hidden}, gap, NAMES), folder / "gap")

    return at


LATE = [("read_late", 6.6)]
"""About 15 standard errors of the rows effects are chosen and fitted on (`evaluation.blind.size`). So are all sizes."""


@pytest.fixture(scope="session")
def late(look: Look) -> Looked:
    """Flights whose readings are 6.6 ms late, which is what latency is called."""
    return look(flown(1, LATE))


@pytest.mark.parametrize("regime", ["iid", *slow("run_offsets", "heavy_outliers")])
def test_nothing_is_named_where_nothing_is_hidden(look: Look, regime: Regime) -> None:
    looked = look(flown(1, regime=regime))
    assert (looked.found.effects, looked.found.unknown) == ((), ())
    # Offsets of 20 held-out runs can leave a bias of half a sigma, which no noise floor excuses.
    assert looked.found.verdict == "nothing missing" or regime == "run_offsets"
    assert looked.found.detectable


@pytest.mark.slow
def test_readings_that_depend_on_each_other_have_no_name(look: Look) -> None:
    looked = look(flown(1, regime="ar1"))
    assert (looked.found.effects, looked.found.unknown) == ((), ())
    assert "correlation" in [each.name for each in looked.found.calibration]


def test_a_known_effect_has_its_name_and_its_number(late: Looked) -> None:
    assert late.outcome.exact
    assert late.outcome.class_sizes == (1,)
    assert late.found.verdict == "explained"
    delay_ms = late.effect.parameters["delay_ms"]
    assert delay_ms.low is not None
    assert delay_ms.high is not None
    assert 5.0 < delay_ms.low < 6.6 < delay_ms.high < 8.2
    assert late.effect.z is not None
    assert late.effect.z > 3.0
    # What flies is what is quoted: the number of all runs.
    (flies,) = (each for each in load_model(late.folder / "model.yaml").effects if each.effect.name == "latency")
    assert flies.values["delay_ms"] == pytest.approx(delay_ms.value, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mechanism", "size", "of"),
    [
        ("wash_across_the_path", 0.59, None),
        ("long_grass", 0.15, "grass"),
        ("high_byte_lost", 0.175, None),
    ],
)
def test_what_is_hidden_has_its_name(look: Look, mechanism: str, size: float, of: str | None) -> None:
    looked = look(flown(1, [(mechanism, size)]))
    assert looked.outcome.exact, (looked.found.effects, looked.found.unknown)
    assert looked.effect.of == of
    assert looked.outcome.class_sizes == (1,)
    assert looked.found.verdict in ("explained", "partly explained")
    nats = known(looked.found.gap).nats_per_reading
    assert known(nats.after) < 0.7 * known(nats.before)


def test_the_extended_model_is_right_of_other_flights(late: Looked) -> None:
    others = flown(2, LATE)
    given = {**others.columns, "previous_reading_cm": np.full(others.reading_cm.size, np.nan)}
    before, after = (
        load_model(path).log_prob(others.reading_cm, given).mean()
        for path in (late.found.settings.model, late.folder / "model.yaml")
    )
    # 15 standard errors of 2000 readings are 225 / 2 nats.
    assert after - before == pytest.approx(112.0 / 2000.0, rel=0.3)


@pytest.mark.slow
def test_what_is_in_no_catalogue_is_called_unknown(look: Look) -> None:
    looked = look(flown(1, [("resonant_housing", 1.17)]))
    assert looked.outcome.found_unknown
    assert not looked.outcome.named
    (unknown,) = looked.found.unknown
    peak = max(unknown.curve, key=lambda point: point[1])
    assert 60.0 < peak[0] < 72.0


@pytest.mark.slow
def test_indistinguishable_effects_are_reported_with_the_experiment(look: Look) -> None:
    looked = look(flown(1, [("air_not_compensated", 0.075)], twist="air of one temperature"))
    assert not looked.outcome.resolved_wrongly
    names = {looked.effect.name, *(other.name for other in looked.effect.alternatives)}
    assert looked.effect.verdict == "indistinguishable"
    assert {"air_temperature", "range_scale"} <= names
    assert "vary air_temperature_c" in looked.effect.experiment


# Two checks of honesty.


@pytest.mark.slow
def test_with_the_cause_shuffled_the_name_is_gone(look: Look) -> None:
    flights = flown(1, LATE)
    rate = flights.columns["range_rate_cm_s"]
    shuffled = flights.columns | {"range_rate_cm_s": np.random.default_rng(1).permutation(rate)}
    looked = look(Flown(shuffled, flights.reading_cm, "iid", ()))
    assert (looked.found.effects, looked.found.unknown) == ((), ())


@pytest.mark.slow
def test_what_one_run_shows_is_no_effect(look: Look) -> None:
    flights, nothing = flown(1, [("read_late", 40.0)]), flown(1)
    one = flights.columns["run"] == np.unique(flights.columns["run"])[7]
    looked = look(Flown(flights.columns, np.where(one, flights.reading_cm, nothing.reading_cm), "iid", ()))
    assert (looked.found.effects, looked.found.unknown) == ((), ())
    assert any("was dropped" in each for each in looked.found.messages)
