"""An object at a fixed range in the beam is found wherever it is, and not among ordinary short readings."""

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.candidates import CandidateEffect
from msp_lab.gap.fixed_echo import fixed_echo
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.refit import fit_base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor

MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
N = 6000


def found(reading_cm: NDArray[np.float64], true_cm: NDArray[np.float64]) -> tuple[CandidateEffect, ...]:
    prepared = Prepared.of(MODEL, {"true_range_cm": true_cm}, reading_cm)
    return fixed_echo(prepared, fit_base(prepared))


@pytest.mark.parametrize("seed", range(4))
def test_a_leg_in_the_beam_is_found_where_it_is_and_else_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true_cm = rng.uniform(60.0, 700.0, N)
    reading_cm = np.array(sensor().readings(true_cm.tolist(), seed))
    assert found(reading_cm, true_cm) == ()
    place_cm = (40.0, 168.0, 310.0, 520.0)[seed]
    hits_leg = (rng.random(N) < 0.02) & (true_cm > place_cm + 10.0)
    with_leg_cm = np.where(hits_leg, np.rint(rng.normal(place_cm, 2.0, N)), reading_cm)
    (candidate,) = found(with_leg_cm, true_cm)
    assert candidate.key == ("clutter", None)
    assert dict(candidate.shape)["location_cm"] == pytest.approx(place_cm, abs=3.0)


def test_where_the_surface_is_unknown_nothing_is_in_front_of_it() -> None:
    readings = np.rint(np.random.default_rng(1).normal(200.0, 2.0, 300))
    assert found(readings, np.full(300, np.nan)) == ()
