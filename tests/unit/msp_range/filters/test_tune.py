"""Q and R from recordings: given back as they were put in, by the filter's own innovations, and clear user errors."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from filterpy.kalman import KalmanFilter

from msp_range.clock import VirtualClock
from msp_range.config import load_airframe
from msp_range.filters.kalman import START_SPEED_STD_M_S, KalmanParameters
from msp_range.filters.tune import NOT_COUNTED, log_likelihood, tune, without_outliers
from msp_range.recording.writer import Recorder
from tests.support.programs import run
from tests.support.shipped import CONFIGS

VELOCITY = KalmanParameters(filter="kalman")
CONSTANT = KalmanParameters(filter="kalman", model="constant")


def flight(acceleration_std_m_s2: float, sigma_m: float, count: int, seed: int) -> list[tuple[float, float]]:
    """A vehicle whose acceleration is drawn anew at each of the irregular readings."""
    draw = np.random.default_rng(seed)
    time_s, height_m, climb_m_s, out = 0.0, 10.0, 0.0, []
    for _ in range(count):
        t = draw.uniform(0.05, 0.4)
        a = draw.normal(scale=acceleration_std_m_s2)
        time_s, height_m, climb_m_s = time_s + t, height_m + climb_m_s * t + a * t * t / 2, climb_m_s + a * t
        out.append((time_s, height_m + draw.normal(scale=sigma_m)))
    return out


@pytest.mark.parametrize("moving", [True, False])
def test_the_likelihood_is_that_of_the_filters_innovations(moving: bool) -> None:
    track = flight(0.5, 0.03, 80, 1)
    q, r_m2 = (0.7, 0.02**2) if moving else (0.01**2, 0.02**2)
    kalman = KalmanFilter(dim_x=2 if moving else 1, dim_z=1)
    kalman.H = np.eye(1, 2 if moving else 1)
    kalman.x[0, 0] = track[0][1]
    kalman.P = np.diag([r_m2, START_SPEED_STD_M_S**2]) if moving else np.array([[r_m2]])
    total = 0.0
    for i in range(1, len(track)):
        t = track[i][0] - track[i - 1][0]
        if moving:
            noise = q * q * np.array([[t**4 / 4, t**3 / 2], [t**3 / 2, t * t]])
            kalman.predict(F=np.array([[1.0, t], [0.0, 1.0]]), Q=noise)
        else:
            kalman.predict(F=np.eye(1), Q=np.array([[q]]))
        kalman.update(np.array([[track[i][1]]]), R=np.array([[r_m2]]))
        if i > NOT_COUNTED:
            total += kalman.log_likelihood
    assert log_likelihood(track, moving, q, r_m2) == pytest.approx(total, rel=1e-9)


def test_a_gap_begins_anew() -> None:
    one = flight(0.5, 0.03, 60, 1)
    other = [(time_s + 100.0, range_m + 50.0) for time_s, range_m in flight(0.5, 0.03, 60, 2)]
    parts = log_likelihood(one, True, 0.5, 1e-3) + log_likelihood(other, True, 0.5, 1e-3)
    assert log_likelihood([*one, *other], True, 0.5, 1e-3) == pytest.approx(parts)


@pytest.mark.parametrize(
    ("acceleration_std_m_s2", "sigma_m"),
    [(2.0, 0.05), pytest.param(0.3, 0.02, marks=pytest.mark.slow), pytest.param(1.0, 0.01, marks=pytest.mark.slow)],
)
def test_q_and_r_are_given_back_within_their_intervals(acceleration_std_m_s2: float, sigma_m: float) -> None:
    inside, count = 0, 12
    for seed in range(count):
        tuned = tune([flight(acceleration_std_m_s2, sigma_m, 300, seed)], VELOCITY, 3.9)
        q, r = tuned.fitted
        assert q.value == pytest.approx(acceleration_std_m_s2, rel=0.35)
        assert math.sqrt(r.value) == pytest.approx(100 * sigma_m, rel=0.35)
        inside += (q.low < acceleration_std_m_s2 < q.high) + (r.low < (100 * sigma_m) ** 2 < r.high)
        assert tuned.after >= tuned.before
    # 95 % of twenty-four: four misses or fewer in 97 of a hundred times.
    assert inside >= 2 * count - 4


def test_outliers_change_nothing_and_a_step_is_no_outlier() -> None:
    track = flight(0.3, 0.02, 400, 5)
    outlying = [(t, z - 2.0 if i % 25 == 7 else z) for i, (t, z) in enumerate(track)]
    found, clean = tune([outlying], VELOCITY, 3.9), tune([track], VELOCITY, 3.9)
    assert found.outliers == 16
    for one, other in zip(found.fitted, clean.fitted, strict=True):
        assert one.value == pytest.approx(other.value, rel=0.15)
    step = [(0.1 * i, 3.0 if i < 50 else 2.0) for i in range(100)]
    assert without_outliers(step) == step
    assert without_outliers(track[:3]) == track[:3]


def test_what_the_readings_do_not_determine_has_no_interval() -> None:
    """A vehicle that only moves: a constant model puts all into Q, and R may be anything small."""
    track = [(0.1 * i, 1.0 + 0.3 * i) for i in range(200)]
    tuned = tune([track], CONSTANT, 3.9)
    assert tuned.fitted[1].high == math.inf or tuned.fitted[1].low == 0.0


def recording(path: Path, tracks: dict[str, list[tuple[float, float]]], filters: list[dict[str, object]]) -> Path:
    content = yaml.safe_load((CONFIGS / "quad_pallet.yaml").read_text()) | {"filters": filters}
    airframe_file = CONFIGS / "quad_pallet.yaml"
    files = dict(load_airframe(airframe_file).files) | {"airframe.yaml": yaml.safe_dump(content)}
    recorder = Recorder(path, VirtualClock(), files=files)
    for name, track in tracks.items():
        for time_s, range_m in track:
            times = {"time_s": time_s, "ping_s": time_s, "read_s": time_s}
            message = {"status": "ok", "suspect": False, "range_m": range_m, "corrected_m": range_m}
            recorder.write(f"/range/{name}", time_s, {**times, **message})
    recorder.close()
    return path


def test_the_line_that_is_printed_is_one_of_an_airframe_file(tmp_path: Path) -> None:
    tracks = {name: flight(0.4, 0.03, 300, seed) for seed, name in enumerate(("front_left", "rear_left"))}
    path = recording(tmp_path / "f.mcap", tracks, [{"filter": "kalman", "gate_sigmas": 3.0}])
    out = run("msp-range tune", path).stdout
    line = yaml.safe_load(out[out.index("filters:") :])["filters"][0]
    parameters = KalmanParameters.model_validate(line)
    assert parameters.gate_sigmas == 3.0
    assert parameters.acceleration_std_m_s2 == pytest.approx(0.4, rel=0.2)
    assert parameters.measurement_variance_cm2 == pytest.approx(9.0, rel=0.2)
    before, after = (float(part.split()[0]) for part in out.split("log likelihood: ")[1].split("before, "))
    assert after > before + 5
    options = ["--model", "constant", "--airframe", CONFIGS / "quad_pallet.yaml"]
    assert "process_variance_cm2" in run("msp-range tune", path, path, *options).stdout


def test_user_errors_are_reported_in_a_line(tmp_path: Path) -> None:
    short = recording(tmp_path / "short.mcap", {"front_left": flight(0.4, 0.03, 20, 1)}, [])
    nothing = recording(tmp_path / "nothing.mcap", {}, [])
    (tmp_path / "text.mcap").write_text("hello")
    for path, words in (
        (tmp_path / "none.mcap", "No such file"),
        (tmp_path / "text.mcap", "not an MCAP recording"),
        (nothing, "no readings with a range"),
        (short, "found 20 readings with a range; expected 100 or more"),
    ):
        result = run("msp-range tune", path, code=3)
        assert result.stdout == ""
        assert str(path) in result.stderr
        assert words in result.stderr
        assert len(result.stderr.strip().splitlines()) == 1
