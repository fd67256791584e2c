"""Scores of effects that are mixed in: expected squares against sums over all readings, estimates against the truth."""

from pathlib import Path

import numpy as np
import pytest

from msp_lab.fleet.rare import RARE_SHARE, RareReadings
from msp_lab.fleet.unit import SimulatedScores, Unit, examine, sums_over_sessions
from msp_lab.gap.candidates import candidates_of
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.refit import refit
from msp_lab.gap.screen import replicate, score_matrix
from msp_lab.readings.dataset import record_runs, write_tables
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.model import Model
from tests.support.measured import MODEL as SENSOR

MODEL = Model.of(load_sensor_model(SENSOR).model_copy(update={"effects": ()}))
SESSIONS, ROWS = 10, 400
NAMES = ("multipath", "lost_high_byte", "latency")


def test_a_session_of_400_replicates_knows_what_second_echoes_would_show() -> None:
    rng = np.random.default_rng(3)
    n = SESSIONS * ROWS
    contexts = {"true_range_cm": rng.uniform(60.0, 350.0, n), "range_rate_cm_s": 60.0 * rng.standard_normal(n)}
    candidates = [each for each in candidates_of(MODEL, contexts)[0] if each.effect.name in NAMES]
    session = np.arange(n) // ROWS
    zero = Base()

    def squares(drawn: Prepared, weight: np.ndarray) -> np.ndarray:
        scores = score_matrix(drawn, zero, [], candidates)[:, len(BASE) :]
        return np.stack([np.bincount(session, weight * each**2, SESSIONS) / ROWS for each in scores.T], axis=1)

    # The exact ones: every twentieth row with all codes that can be read.
    some = np.arange(0, n, 20)
    codes = np.arange(20.0, 766.0)
    every = {name: np.repeat(column[some], codes.size) for name, column in contexts.items()}
    given = Prepared.of(MODEL, every, np.tile(codes, some.size))
    probability = np.exp(given.log_prob(zero, []))
    scores = score_matrix(given, zero, [], candidates)[:, len(BASE) :]
    exact = np.stack(
        [np.bincount(session[some].repeat(codes.size), probability * each**2, SESSIONS) for each in scores.T], axis=1
    ) / (ROWS / 20)

    plain = replicate(MODEL, zero, [], contexts, rng, n)
    fit = refit(plain, [], zero, rounds=0)
    rare = RareReadings(plain, fit, candidates, rng)
    weight = rare.weights(score_matrix(rare.prepared, zero, [], candidates)[:, len(BASE) :])
    assert weight.max() <= 1.0 / (1.0 - RARE_SHARE) + 1e-12
    assert abs(weight.mean() - 1.0) < 0.02
    found = squares(rare.prepared, weight) / exact
    assert found.min() > 0.2, found
    assert found.max() < 5.0, found
    # Readings of the model alone hardly ever fall on twice the range.
    multipath = [each.effect.name for each in candidates].index("multipath")
    assert (squares(plain, np.ones(n))[:, multipath] < 0.1 * exact[:, multipath]).any()


def test_sums_of_sessions_give_a_share_and_by_how_much_they_vary() -> None:
    # Three kinds of readings; a share b makes each 1 + b times its score as frequent. Four times as many readings are
    # measured as simulated, so that what the simulated ones leave open is a good part of the variance.
    rng = np.random.default_rng(7)
    usual = np.array([0.02, 0.1, 0.88])
    of_kind = np.array([20.0, 2.0, -0.6 / 0.88])
    drawn_as, share = np.array([0.1, 0.1, 0.8]), 0.02
    here, there = np.arange(1600) // 800, np.arange(400) // 200

    def sums(b: float) -> tuple[np.ndarray, ...]:
        kinds, seen = rng.choice(3, there.size, p=drawn_as), rng.choice(3, here.size, p=usual * (1.0 + b * of_kind))
        scores, bounded = of_kind[:, None], (of_kind / (1.0 + 0.1 * of_kind))[:, None]
        simulated = SimulatedScores((usual / drawn_as)[kinds, None], scores[kinds], bounded[kinds])
        return sums_over_sessions(simulated, there, bounded[seen], here, np.array([True]), 2)

    without, with_ = (np.array([sums(b) for _ in range(400)])[..., 0] for b in (0.0, share))
    score, information, variance = (without[:, k] for k in range(3))
    assert abs(score.mean()) < 0.1 * score.std()
    assert with_[:, 0].mean() / information.mean() == pytest.approx(share, rel=0.1)
    # By hand from the three kinds: of 800 measured readings, and of the mean of 200 simulated ones, of which only what
    # does not follow the score is left.
    bounded = of_kind / (1.0 + 0.1 * of_kind)
    left = bounded - of_kind * (usual @ (bounded * of_kind)) / (usual @ of_kind**2)
    of_mean = (usual**2 / drawn_as) @ left**2 - (usual @ left) ** 2
    expected = 800.0 * (usual @ bounded**2 - (usual @ bounded) ** 2) + 800.0**2 / 200.0 * of_mean
    assert score.var() == pytest.approx(expected, rel=0.1)
    assert variance.mean() == pytest.approx(expected, rel=0.1)


def test_one_step_estimates_a_share_of_repeated_readings(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    sessions = tuple(f"V1/{number}" for number in range(4))
    for name in sessions:
        time_s = 0.1 * np.arange(500)
        contexts = {"time_s": time_s, "true_range_cm": 250.0 + 80.0 * np.sin(0.8 * time_s + rng.uniform(0.0, 6.0))}
        reading_cm = MODEL.sample(contexts, rng)
        for k in np.flatnonzero(rng.random(500) < 0.05).tolist():
            reading_cm[k] = reading_cm[max(k - 1, 0)]
        write_tables(tmp_path, name, {"down": MeasuredData({**contexts, "reading_cm": reading_cm})})
        record_runs(tmp_path, [name], {"file": f"{name}.csv"})
    found = examine(MODEL, (Unit(tmp_path, "V1", "down", sessions, 1), (), True))
    k = [each.effect for each in found.terms].index("stale")
    share = found.score[:, k].sum() / found.information[:, k].sum()
    error = np.sqrt(found.variance[:, k].sum()) / found.information[:, k].sum()
    # 100 repeats, of which most are off the truth by several sigma.
    assert abs(share - 0.05) < 3.0 * error
    assert error < 0.01
    # Of the other shares there is nothing.
    others = [k for k, each in enumerate(found.terms) if each.effect in ("multipath", "dead_zone_minimum", "clutter")]
    size = found.score[:, others].sum(axis=0) / np.sqrt(np.maximum(found.variance[:, others].sum(axis=0), 1e-12))
    assert np.abs(size).max() < 4.0
