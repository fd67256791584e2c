"""How soon objects under one corner are found and how often none is, by readings of the shipped sensor model."""

import numpy as np
import pytest

from msp_range.assembly import fusion_of
from msp_range.config import load_airframe
from msp_range.fusion import AttitudeTrack
from msp_range.reading import Reading
from msp_range.reading_model.mixture import ReadingModel
from msp_range.sensors.mb1242 import MB1242, decode, encode
from msp_range.sensors.schedule import AnswerTiming, PolledSensor, RoundRobin
from msp_sim.device.bus import EmulatedBus
from tests.support.shipped import CONFIGS

pytestmark = pytest.mark.slow
AIRFRAME = load_airframe(CONFIGS / "quad_pallet.yaml")
NAMES = [sensor.name for sensor in AIRFRAME.sensors]
SLOT_S = 0.1
ANSWERED_S = 0.030
STD_M = 0.0196
ANY_DEVICE = MB1242(EmulatedBus([], lambda: 0.0), 0x70)


class Hover:
    """Four sensors at a height that bobs, one of which may have an object below it.

    Parameters
    ----------
    height_m
        Mean height of the sensors over the ground [m].
    draw
        Its random seed.
    """

    def __init__(self, height_m: float, draw: np.random.Generator) -> None:
        self.readings = ReadingModel.of(AIRFRAME.sensors[0].sensor_model)
        self.fusion = fusion_of(AIRFRAME, AttitudeTrack())
        self.height_m, self.draw, self.slot = height_m, draw, 0
        # The real order of pings: a reading that does not fit is asked for again.
        self.order = RoundRobin(
            [[PolledSensor(name, ANY_DEVICE, AnswerTiming(0.01, 0.08))] for name in NAMES], SLOT_S, 0.0
        )
        self.next = self.order.turn(0.0, True)[1][0].name

    def step(self, below: str | None = None, object_m: float = 0.0) -> tuple[str, float, float | None]:
        """One reading: whose, when it was reported [s], and what is now thought to be below that sensor [m]."""
        assert self.fusion is not None
        name, time_s = self.next, self.slot * SLOT_S
        self.slot += 1
        range_m = self.height_m + 0.05 * np.sin(1.5 * time_s) - (object_m if name == below else 0.0)
        reading_cm = self.readings.sample({"true_range_cm": [100 * range_m]}, self.draw)[0]
        decoded = decode(encode(int(reading_cm)))
        std_m = None if decoded.range_m is None else STD_M
        echo_s = time_s + range_m * 2.9e-3
        reading = Reading(echo_s, name, decoded.status, decoded.range_m, std_m, decoded.raw, decoded.suspect)
        outcome = self.fusion.update(reading, time_s + ANSWERED_S)
        # The next turn is planned before this reading's outcome is known.
        self.next = self.order.turn(time_s, True)[1][0].name
        if self.fusion.asks_again(outcome):
            self.order.again(name)
        return name, time_s + ANSWERED_S, self.fusion.object_m(name)


def test_objects_of_30_cm_or_more_are_found_within_1200_ms_in_95_percent() -> None:
    draw = np.random.default_rng(11)
    waits_s = []
    for _ in range(300):
        height_m = draw.uniform(1.0, 4.0)
        object_m, comes_s = draw.uniform(0.3, min(1.2, height_m - 0.4)), draw.uniform(4.0, 5.0)
        hover, corner = Hover(height_m, draw), NAMES[draw.integers(4)]
        wait_s = np.inf
        while wait_s == np.inf and hover.slot * SLOT_S < comes_s + 2.0:
            is_there = hover.slot * SLOT_S >= comes_s
            name, time_s, seen_m = hover.step(corner if is_there else None, object_m)
            if is_there and name == corner and seen_m is not None:
                wait_s = time_s - comes_s
                assert seen_m == pytest.approx(object_m, abs=0.15)
        waits_s.append(wait_s)
    # 0.95 within two standard deviations of 300 trials; the benchmark tries more of them.
    assert np.mean(np.array(waits_s) <= 1.2) > 0.935


def test_in_1000_seconds_over_flat_ground_there_is_no_object() -> None:
    draw = np.random.default_rng(12)
    for height_m in (1.0, 1.5, 2.0, 3.0, 4.0):
        hover = Hover(height_m, draw)
        assert {hover.step()[2] for _ in range(2000)} == {None}
