"""The blind generator against published values and against what can be worked out by hand."""

import numpy as np
import pytest

from evaluation.blind import air, sound
from evaluation.blind.flight import REGIMES, contexts, fly, habits, land
from evaluation.blind.mechanisms import KNOWN, MECHANISMS, UNKNOWN
from evaluation.blind.receiver import Receiver
from evaluation.blind.score import accepted_names
from evaluation.blind.size import fly_plain, measure, stage
from evaluation.blind.tables import draw_cases, draw_plan, fly_case

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("celsius", "humidity_pct", "db_km"),
    [(10, 70, 117.0), (20, 70, 76.6), (30, 70, 59.3), (15, 20, 202.0), (15, 50, 129.0)],
)
def test_absorption_is_that_of_iso_9613_2_table_2(celsius: float, humidity_pct: float, db_km: float) -> None:
    """At the octave of 8 kHz, whose middle is 10^3.9 Hz; to the table's rounding."""
    assert 1000.0 * air.absorption_db_m(celsius, humidity_pct, 10**3.9) == pytest.approx(db_km, rel=5e-3)


def test_speed_of_sound() -> None:
    """331.3 m/s at 0 C dry; 0.3 % more at 20 C when the air is saturated (Cramer 1993: 344.4)."""
    assert air.speed_m_s(0.0, 0.0) == pytest.approx(331.3, abs=0.1)
    assert air.speed_m_s(20.0, 100.0) == pytest.approx(344.4, abs=0.2)


def test_a_path_through_two_airs_takes_the_time_of_both() -> None:
    sharp = air.boxed_slowness_s_m(46.0, 21.0, 2.0, 0.3, 0.001)
    by_hand = (0.3 / air.speed_m_s(46.0) + 1.7 / air.speed_m_s(21.0)) / 2.0
    assert sharp == pytest.approx(by_hand, rel=2e-5)
    assert air.mean_slowness_s_m(10.0, 30.0, 0.0) == pytest.approx(
        2.0 / (air.speed_m_s(10.0, 0.0) + air.speed_m_s(30.0, 0.0)), rel=1e-6
    )


def test_piston_has_its_first_null_and_side_lobe() -> None:
    """x = 3.8317; the side lobe at 5.136 is 17.6 dB down."""
    wavelength = 0.01
    angle = np.arcsin(np.array([3.8317, 5.1356]) * wavelength / np.pi / 0.03)
    null, lobe = sound.piston(angle, 0.03, wavelength)
    assert null < 1e-4
    assert 20.0 * np.log10(lobe) == pytest.approx(-17.57, abs=0.02)


def test_half_a_mirror_gives_half_the_pressure() -> None:
    """The mirror point on the edge of a plate that is large otherwise; far off it, nothing."""
    half = np.array([1000.0])
    for tilt, share in ((np.arcsin(1.0), 0.5), (0.0, 1.0)):
        amplitudes, _ = sound.plate(half, half, np.inf, tilt, 0.008)
        assert abs(amplitudes.sum()) == pytest.approx(share, abs=0.02)


def test_a_quiet_echo_is_found_on_its_rise() -> None:
    """1 - (1 + x) exp(-x) = threshold / pressure, x from the first edge in units of the rise time."""
    receiver = Receiver()
    x = 2.0
    level = receiver.threshold_pa(0.01) / (1.0 - (1.0 + x) * np.exp(-x))
    found = receiver.crossing_s(
        np.array([[level + 0j]]), np.array([[0.01]]), np.array([1e-12]), np.random.default_rng(0)
    )
    assert found[0] - 0.01 == pytest.approx(x * receiver.rise_s, abs=2e-6)


def test_noise_crosses_at_rice_s_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise alone against the rate from which false alarms are drawn: rare enough not to come in clumps, and sampled
    finely enough not to slip between two samples, as a fifth do with the step that echoes are sampled with."""
    monkeypatch.setattr("evaluation.blind.receiver.STEP_S", 3e-6)
    receiver = Receiver(threshold_range_cm=(20.0, 765.0), threshold_db=(60.0, 60.0), burst_s=1e-3)
    rows, rho = 40_000, 3.8
    noise = np.full(rows, np.sqrt(2.0) * receiver.threshold_pa(0.01) / rho)
    rng = np.random.default_rng(1)
    window_s = receiver.burst_s + 1.5e-4
    sampled = receiver.crossing_s(np.full((rows, 1), 1e-9 + 0j), np.full((rows, 1), 0.01), noise, rng)
    # A window begins above the threshold with probability exp(-rho^2 / 2), which is no crossing.
    share = np.isfinite(sampled).mean() - np.exp(-(rho**2) / 2.0)
    alarms = receiver.false_alarm_s(noise, rng) - 20.0 * receiver.tick_s
    assert share == pytest.approx((alarms < window_s).mean(), rel=0.1)


@pytest.mark.parametrize("regime", REGIMES)
def test_flights_with_nothing_hidden_have_no_trend(regime: str) -> None:
    """Hits do not depend on any context: nothing beyond 4.5 standard errors, runs taken as the unit."""
    rng = np.random.default_rng(4)
    columns = contexts(rng, 80, 100, regime)  # type: ignore[arg-type]
    reading_cm = land(fly(columns, habits(regime), rng), rng)  # type: ignore[arg-type]
    error = reading_cm - columns["true_range_cm"]
    hit = (np.abs(error) < 6.0) & (reading_cm != 255.0)
    error -= error[hit].mean()
    for name, column in columns.items():
        if column.dtype.kind == "f" and name != "time_s":
            x = np.asarray(column, dtype=float) - np.mean(np.asarray(column, dtype=float))
            by_run = (x * error * hit).reshape(80, 100).sum(axis=1)
            assert abs(by_run.sum()) < 4.5 * np.sqrt((by_run**2).sum()), name


def test_size_is_in_standard_errors() -> None:
    """Half of the sensors lower by d: d sqrt(rows shared / 4) / sigma."""
    columns = contexts(np.random.default_rng(1), 40, 100)
    size = measure(columns, habits("iid"), "one_hangs_lower", 0.3, 1)
    assert size.total == pytest.approx(0.3 * np.sqrt(0.95 * 2000 / 4) / 0.78, rel=0.05)


def test_size_of_a_spread_is_in_standard_errors() -> None:
    """The variance of a reading goes from v to v + d throttle^4; a variance's standard error is itself sqrt(2 / n)."""
    columns = contexts(np.random.default_rng(1), 40, 100)
    added = (0.6 * (columns["throttle"] / 0.5) ** 2) ** 2
    by_hand = added.std() / (0.78**2 + added.mean()) * np.sqrt(0.95 * 2000 / 2.0)
    size = measure(columns, habits("iid"), "wash_across_the_path", 0.6, 1)
    assert size.spread == pytest.approx(by_hand, rel=0.12)


def test_size_of_offsets_between_runs_is_what_the_likelihood_gains() -> None:
    """Means of 20 runs of 95 hits each, whose variance is 1 + 95 (0.3 / 0.78)^2 times what it is without."""
    columns = contexts(np.random.default_rng(1), 40, 100)
    rng = np.random.default_rng(2)
    spread = np.sqrt(1.0 + 95.0 * (0.3 / 0.78) ** 2)
    means = spread * rng.standard_normal((4000, 20))
    gained = (0.5 * means**2 - 0.5 * means**2 / spread**2 - np.log(spread)).sum(axis=1).mean()
    assert measure(columns, habits("iid"), "remounted", 0.3, 1).total == pytest.approx(np.sqrt(2.0 * gained), rel=0.06)


@pytest.mark.parametrize("name", ["steep", "transmitter"])
def test_flights_without_are_flown_again_only_where_the_contexts_change(name: str) -> None:
    columns = contexts(np.random.default_rng(1), 10, 100)
    before = fly_plain(columns, habits("iid"), name, 1.5, 1, 2)
    after = fly_plain(columns, habits("iid"), name, 1.2, 1, 2, before)
    again = fly_plain(columns, habits("iid"), name, 1.2, 1, 2)
    assert (after is before) == (name == "transmitter")
    assert (after.reading_cm == again.reading_cm).all()


@pytest.mark.parametrize("name", MECHANISMS)
def test_every_mechanism_does_something_and_only_while_it_is_there(name: str) -> None:
    mechanism = MECHANISMS[name]
    columns = contexts(np.random.default_rng(2), 10, 100)
    seed = np.random.SeedSequence(3)
    _, plain = stage(columns, habits("iid"), [], seed)
    _, again = stage(columns, habits("iid"), [], seed)
    _, changed = stage(columns, habits("iid"), [(name, 2.0 * mechanism.guess)], seed)
    assert (plain == again).all()
    assert (plain != changed).any()


def test_every_known_mechanism_has_a_name_and_no_unknown_one() -> None:
    names = accepted_names()
    assert set(names) == set(KNOWN)
    assert all(each.channel and each.variables for each in UNKNOWN.values())


def test_cases_are_the_seed_s_and_their_answers_are_apart() -> None:
    cases = draw_cases(7, 200)
    assert cases == draw_cases(7, 200)
    assert cases != draw_cases(8, 200)
    kinds = [case.kind for case in cases]
    assert kinds.count("null") >= 50
    assert kinds.count("unknown") >= 40
    (one,) = draw_cases(7, 1, "unknown", standard_errors=10.0)
    columns, reading_cm, hidden = fly_case(one)
    assert not {"mechanism", "size", "condition"} & set(columns)
    assert len(reading_cm) == 4000
    assert hidden[0]["standard_errors"] == pytest.approx(10.0, rel=0.1)


def test_a_plan_can_be_raised_and_a_part_of_it_is_like_the_whole() -> None:
    few, many = (draw_plan(3, [f"null={n}", f"one:6={2 * n}", "confounded=8"]) for n in (4, 8))
    by_number = {case.number: case for case in many}
    assert len(by_number) == len(many) == 6 * 8 + 16 + 8
    assert all(by_number[case.number] == case for case in few)
    half = [case.kind for case in many[: len(many) // 2]]
    assert 23 <= half.count("null") <= 25
    assert 7 <= half.count("one") <= 9
    for wrong in ("one:7=3", "all=3", "one:6", "one:6=x"):
        with pytest.raises(ValueError, match="expected WHAT=COUNT"):
            draw_plan(3, [wrong])
