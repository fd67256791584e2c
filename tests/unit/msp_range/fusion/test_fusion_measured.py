"""The object logic on a real ranger that flew over a box (crazyflie-terrain/log07.csv, a time-of-flight sensor).

One sensor cannot tell an object from the ground, so the vehicle's own estimate of its height over the floor stands in
for two others that see the floor. It is measured and not made up, and knows nothing of the box.
"""

import numpy as np
import pytest

from msp_range.fusion import AttitudeTrack, DownwardSensor, Fusion, Windows
from msp_range.reading import Reading, Status
from tests.support.data import measured_data

STD_M = 0.008
"""Of the ranger about the floor, and of the estimate: what the first seconds over the floor show."""
DOWN = (0.0, 0.0, 1.0)
FLYING_M = 0.3
BOX_M = 0.16
"""How much shorter the ranger reads over the box than over the floor, by hand from the record."""


def test_the_boxes_of_a_real_flight_are_found_and_left_out_of_the_ground() -> None:
    table = np.genfromtxt(measured_data("crazyflie-terrain/log07.csv"), delimiter=",", names=True)
    fusion = Fusion(
        {name: DownwardSensor((0.0, 0.0, 0.0), DOWN, "slant") for name in ("ranger", "p", "q")},
        AttitudeTrack(),
        Windows(),
    )
    seen, off_m = [], []
    for i, (time_s, range_m, floor_m) in enumerate(zip(table["t_s"], table["range_m"], table["est_z_m"], strict=True)):
        if floor_m < FLYING_M:
            continue
        for name, each_m, raw in (("pq"[i % 2], floor_m, 2 * i), ("ranger", range_m, 2 * i + 1)):
            fused = fusion.update(Reading(time_s, name, Status.OK, each_m, STD_M, raw), time_s).fused
        object_m = fusion.object_m("ranger")
        seen.append((time_s, 0.0 if object_m is None else object_m))
        if fused is not None:
            off_m.append(fused.range_m - floor_m)
    times_s, high_m = np.array(seen).T
    changes = np.flatnonzero(np.diff(high_m != 0.0))
    begins_s, ends_s = times_s[changes[::2] + 1], times_s[changes[1::2] + 1]
    # By the record: a step of the range from floor to box at 5.65 s and 8.72 s, back at 7.2 s and 11.8 s.
    assert begins_s == pytest.approx([5.7, 8.75], abs=0.2)
    assert ends_s == pytest.approx([7.2, 11.8], abs=0.2)
    assert np.median(high_m[high_m != 0.0]) == pytest.approx(BOX_M, abs=0.02)
    assert np.abs(off_m).max() < 0.05, "the box does not move the ground"
