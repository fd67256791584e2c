"""Which of four sensors or more does not fit into one plane with the others, where each seems to fit alone.

A sensor that drifts tilts the plane that is fitted to all: each reading is a little off, none is an outlier. On a
rectangle the plane leaves one residual, which shows that one drifts, and only the prior of slopes says which: had
another one drifted, the ground would be steep. Planes are fitted to how much higher each sensor sees the ground than
the known one, were that level.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from msp_range.fusion.ground_filter import SLOPE_STD, GroundFilter
from msp_range.fusion.look import Look
from msp_range.fusion.modes import ODD, ODD_APART, ODD_FITS, SensorMode

FEWEST = 4
"""With fewer sensors any slope explains each of them."""
NOISE_M = 0.03
"""Standard deviation of what a sensor sees lately, about the plane [m]: its mean noise and the ground's roughness.
Larger isolates a sensor that drifts later, smaller isolates sensors over rough ground."""
LEVEL_SHARE, JUMP_M = 0.3, 0.25
"""Share of a reading in what its sensor sees lately, the last second of four; but one that is farther off than the
second is something else [m]."""


class LevelHeight(NamedTuple):
    """What one sensor sees lately: how much higher [m], were the ground level, and how that changes with its rises."""

    higher_m: float
    by_north: float
    by_east: float


class GroundPlane(NamedTuple):
    """A plane of ground by some sensors: how much lower than the known one [m], its rises, and its cost [nats]."""

    lower_m: float
    rise_north: float
    rise_east: float
    cost: float


def plane_of(seen: Sequence[LevelHeight]) -> GroundPlane:
    """The likeliest plane: least squares with the prior of slopes.

    Minimises sum((higher - lower - by . g)^2) / (2 NOISE_M^2) + |g|^2 / (2 SLOPE_STD^2).
    """
    count = len(seen)
    higher_m, north, east = (sum(column) / count for column in zip(*seen, strict=True))
    nn = ee = NOISE_M**2 / SLOPE_STD**2
    ne = of_north = of_east = square = 0.0
    for each in seen:
        z, n, e = each.higher_m - higher_m, each.by_north - north, each.by_east - east
        nn, ne, ee = nn + n * n, ne + n * e, ee + e * e
        of_north, of_east, square = of_north + n * z, of_east + e * z, square + z * z
    size = nn * ee - ne * ne
    rise_north, rise_east = (ee * of_north - ne * of_east) / size, (nn * of_east - ne * of_north) / size
    cost = (square - rise_north * of_north - rise_east * of_east) / (2 * NOISE_M**2)
    return GroundPlane(higher_m - north * rise_north - east * rise_east, rise_north, rise_east, cost)


def odd_one(seen: Sequence[LevelHeight]) -> tuple[int, GroundPlane] | None:
    """Which sensor is odd, and the plane of the others; None: the plane of all is about as likely."""
    heights_m = [each.higher_m for each in seen]
    # A level plane costs at most count (highest - lowest)^2 / (8 NOISE_M^2), and the likeliest one no more.
    is_level = len(seen) * (max(heights_m) - min(heights_m)) ** 2 < 8 * NOISE_M**2 * ODD
    if len(seen) < FEWEST or is_level or (of_all := plane_of(seen).cost) < ODD:
        return None
    without = [plane_of([*seen[:i], *seen[i + 1 :]]) for i in range(len(seen))]
    costs = sorted(plane.cost for plane in without)
    if costs[0] > ODD_FITS or of_all - costs[0] < ODD or costs[1] - costs[0] < ODD_APART:
        return None
    odd = next(i for i, plane in enumerate(without) if plane.cost == costs[0])
    return odd, without[odd]


class OddSensor:
    """What each sensor sees lately of the ground, and which one is odd.

    Parameters
    ----------
    gate_m
        What is farther from the ground than this is not of it [m].
    fresh_s
        How long what a sensor saw counts [s].

    Attributes
    ----------
    mode
        The odd sensor; None: each fits.
    """

    def __init__(self, gate_m: float, fresh_s: float) -> None:
        self._gate_m, self._fresh_s = gate_m, fresh_s
        self._of: GroundFilter | None = None
        self._levels: dict[SensorMode, tuple[float, LevelHeight]] = {}
        self.mode: SensorMode | None = None

    def update(self, known: GroundFilter, look: Look, time_s: float) -> None:
        """Update with a reading; where another sensor is odd from now on, the ground is that of the others."""
        flat = look.turned.view(known.height_m, 0.0, 0.0)
        if flat is None:
            return
        if known is not self._of:
            self.mode, self._of = None, known
            self._levels.clear()
        higher_m = (look.range_m - flat.expected_m) / flat.by_height
        by_north, by_east = flat.by_north / flat.by_height, flat.by_east / flat.by_height
        since_s = time_s - self._fresh_s
        before_s, before = self._levels.get(look.mode, (-math.inf, None))
        off_m = math.inf if before is None or before_s < since_s else higher_m - before.higher_m
        if abs(off_m) < JUMP_M:
            higher_m -= (1.0 - LEVEL_SHARE) * off_m
        elif abs(higher_m - by_north * known.rise_north - by_east * known.rise_east) > self._gate_m:
            return
        self._levels[look.mode] = time_s, LevelHeight(higher_m, by_north, by_east)
        levels = [(mode, level) for mode, (seen_s, level) in self._levels.items() if seen_s >= since_s]
        found = odd_one([level for _, level in levels])
        odd, self.mode = self.mode, None if found is None else levels[found[0]][0]
        if found is not None and self.mode is not odd:
            _, plane = found
            known.tilt(plane.lower_m, plane.rise_north, plane.rise_east)
            for mode, level in levels:
                self._levels[mode] = time_s, level._replace(higher_m=level.higher_m - plane.lower_m)
