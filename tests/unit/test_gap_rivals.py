"""A wrong name is given up for the right one, a needless one goes, and one that does as well is a rival."""

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.name import Chosen, settle
from msp_lab.gap.refit import refit
from msp_lab.gap.search import Item, Search
from msp_lab.gap.units import numbered
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model, active
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
N, RUNS = 2000, 20


def searched(ranges_cm: tuple[float, float], delay_ms: float) -> Search:
    """Flights up and down whose readings are late."""
    rng = np.random.default_rng(3)
    contexts = {
        "time_s": 0.1 * np.arange(N),
        "run": np.array([f"run{k:02d}" for k in np.arange(N) * RUNS // N]),
        "true_range_cm": rng.uniform(*ranges_cm, N),
        "range_rate_cm_s": 80.0 * rng.standard_normal(N),
        "vibration_hz": rng.choice([0.0, 60.0], N),
    }
    heard_cm = contexts["true_range_cm"] - 1e-3 * delay_ms * contexts["range_rate_cm_s"]
    reading_cm = np.array(sensor().readings(heard_cm.tolist(), 3))
    return Search(MODEL, contexts, reading_cm, numbered(contexts["run"]), rng, 0.05)


def settled(search: Search, *names: str) -> Chosen:
    """What becomes of these names."""
    starts = {
        "latency": {"delay_ms": 5.0},
        "motion_during_ping": {"share": -0.5},
        "vibration": {"growth": 0.05},
        "range_scale": {"scale_pct": 0.05},
    }
    fitted = refit(search.prepared, [active(name, None, starts[name]) for name in names])
    of_name = {entry.key[0]: entry for entry in search.tested}
    items = tuple(Item(each, of_name[each.effect.name]) for each in fitted.effects)
    first = search.screen(search.null, [])
    chosen = Chosen(items, (), fitted, first, ())
    return settle(search, chosen, lambda sentence, share: None)


def names_of(chosen: Chosen) -> list[str]:
    return [item.key[0] for item in chosen.items]


def test_a_wrong_name_is_given_up_for_the_right_one() -> None:
    chosen = settled(searched((60.0, 700.0), 25.0), "motion_during_ping")
    assert names_of(chosen) == ["latency"]
    assert chosen.items[0].active.values["delay_ms"] == pytest.approx(25.0, abs=3.0)
    assert "motion_during_ping" not in [rival.active.effect.name for rival in chosen.rivals[0]]


@pytest.mark.parametrize("order", [("latency", "vibration", "range_scale"), ("vibration", "latency")])
def test_a_needless_name_goes(order: tuple[str, ...]) -> None:
    chosen = settled(searched((60.0, 700.0), 25.0), *order)
    assert names_of(chosen) == ["latency"]


def test_a_name_that_does_as_well_is_a_rival() -> None:
    """At one height the way back is always as long: what is late and what moves meanwhile are the same."""
    chosen = settled(searched((299.0, 301.0), 15.0), "latency")
    (rivals,) = chosen.rivals
    (motion,) = [rival for rival in rivals if rival.active.effect.name == "motion_during_ping"]
    assert abs(motion.correlation) > 0.99
    assert abs(motion.loss) < 0.5
    assert motion.separation < 1.0
