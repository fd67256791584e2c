"""An emulated sensor whose model is late reads what was below it then, also where other effects need whole arrays."""

import math

import numpy as np
import pytest
from numpy.random import default_rng

from msp_range.config import load_airframe
from msp_sim.device.emulated import EmulatedSensor, Surroundings
from msp_sim.world.surfaces import GroundSection
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import AirSection, World

SENSOR = load_airframe("quad_pallet").sensors[0]


def height_m(time_s: float) -> float:
    """Up and down by 1 m within 4 s, so that a rate holds for a tenth of a second."""
    return 3.0 + math.sin(math.pi / 2.0 * time_s)


def pose(time_s: float) -> Pose:
    rate_m_s = math.pi / 2.0 * math.cos(math.pi / 2.0 * time_s)
    return Pose(time_s, (0.0, 0.0, -height_m(time_s)), 0.0, 0.0, 0.0, (0.0, 0.0, -rate_m_s))


@pytest.mark.parametrize("more", [[], [{"name": "clutter", "parameters": {"share": 0.0, "location_cm": 50.0}}]])
def test_a_late_sensor_reads_what_was_below_it_then(more: list[dict[str, object]]) -> None:
    late = {"name": "latency", "parameters": {"delay_ms": 500.0}}
    model = SENSOR.sensor_model.model_copy(update={"effects": (late, *more)})
    around = Surroundings(World(GroundSection(surface="concrete"), AirSection()), pose)
    sensor = EmulatedSensor(SENSOR, model, around, default_rng(1), {})
    times_s = 0.1 * np.arange(400)
    read_cm = np.array([sensor.echo(float(each)) for each in times_s])
    mounted_cm = sensor.context(0.0)["true_range_cm"] - 100.0 * height_m(0.0)
    then_cm = np.array([100.0 * height_m(each - 0.5) + mounted_cm for each in times_s])
    off_cm = read_cm - then_cm
    near = np.abs(off_cm) < 12.0
    assert near.mean() > 0.9
    # The linear part alone would be off by up to 29 cm where it turns.
    assert (
        abs(np.corrcoef(off_cm[near], np.array([math.sin(math.pi / 2.0 * each) for each in times_s])[near])[0, 1])
        < 0.15
    )
