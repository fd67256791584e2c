"""Height over the ground, its rate, and the ground's slope: an extended Kalman filter for three ways to move.

State: height h [m], its rate w [m/s], rise of the ground per metre north g_n and east g_e. Between readings h moves
with w, w by white acceleration, and the slope falls back towards level ground, so that what no sensor sees stays
bounded. Three such filters run side by side, for a vehicle that is calm, that moves and that manoeuvres; they are mixed
by how well each foretells the readings (interacting multiple models: Blom and Bar-Shalom, IEEE Transactions on
Automatic Control 33, 1988). Plain floats: for four states that is quicker than arrays.
"""

import math
from typing import NamedTuple

from msp_range.fusion.mounting import View

CALM_M2_S3, MOVING_M2_S3, MANOEUVRE_M2_S3 = 1e-4, 1e-2, 1.0
"""Spectral density of the vehicle's acceleration [m^2/s^3]: at a steady rate; bobbing; changing its speed by a metre a
second within a second."""
WAKES_PER_S, CALMS_PER_S = 0.03, 0.2
"""How often a calm vehicle begins to move, and one that moves becomes calm [1/s]."""
SPURS_PER_S, EASES_PER_S = 0.2, 1.0
"""How often a vehicle that moves begins a manoeuvre, and ends one [1/s]."""
LEAST_SHARE = 1e-3
"""A filter is not mixed with less than this of another."""
START_WEIGHTS = (0.2, 0.4, 0.4)
SHORTEST_BASE_S, START_SLOPE_M = 0.08, 0.05
"""Two readings show a rate where they are this far apart [s]; a slope puts them apart by this [m]."""
SLOPE_STD = 0.10
"""Standard deviation of the ground's rise a metre: 6 deg."""
SLOPE_LASTS_S = 30.0
"""Time constant with which the slope falls back to level where no reading holds it [s]."""
SQRT_TWO_PI = math.sqrt(2 * math.pi)
LEAST_WEIGHT = 1e-4
"""No way to move is ever ruled out further than this."""

_Gaussian = tuple[float, ...]
"""Four means (h, w, g_n, g_e) and the upper triangle of their covariance by rows, ten numbers."""


class Ground(NamedTuple):
    """Where the ground is; variances and covariances of the errors.

    Attributes
    ----------
    height_m, climb_m_s
        Height of the reference point above the plane of the ground, straight up, and how fast it grows [m, m/s].
    rise_north, rise_east
        Rise of the ground per metre; forward and right where the attitude is not known.
    covariance
        Upper triangle by rows of the 4 x 4 covariance in that order, SI units.
    """

    height_m: float
    climb_m_s: float
    rise_north: float
    rise_east: float
    covariance: tuple[float, ...]


class GroundFilter:
    """The three filters and their mixture.

    Parameters
    ----------
    height_m, variance_m2
        Height at the beginning [m], and the variance of its error [m^2].
    higher_m, elapsed_s
        How much higher that is than another reading [m], how long ago [s].

    Attributes
    ----------
    height_m, climb_m_s, rise_north, rise_east
        The mixture's mean; see `Ground`.
    """

    def __init__(self, height_m: float, variance_m2: float, higher_m: float, elapsed_s: float) -> None:
        slope = SLOPE_STD * SLOPE_STD
        apart_s = max(elapsed_s, SHORTEST_BASE_S)
        climb_m_s = higher_m / apart_s
        # Of two places on a slope, perhaps, and each with its noise.
        climb_variance = (2 * variance_m2 + START_SLOPE_M * START_SLOPE_M) / (apart_s * apart_s)
        start = (height_m, climb_m_s, 0.0, 0.0, variance_m2, variance_m2 / apart_s, 0.0, 0.0, climb_variance, 0.0, 0.0)
        filters: list[_Gaussian] = [(*start, slope, 0.0, slope)]
        self._filters = 3 * filters
        self._weights: tuple[float, ...] = START_WEIGHTS
        self.height_m, self.climb_m_s, self.rise_north, self.rise_east = start[:4]

    def predict(self, elapsed_s: float) -> None:
        """Move on by ``elapsed_s``: mix each with its neighbours, then let each move in its own way."""
        if elapsed_s <= 0:
            return
        calm, moving, wild = self._filters
        of_calm, of_moving, of_wild = self._weights
        wakes, calms = of_calm * min(WAKES_PER_S * elapsed_s, 0.5), of_moving * min(CALMS_PER_S * elapsed_s, 0.4)
        spurs, eases = of_moving * min(SPURS_PER_S * elapsed_s, 0.4), of_wild * min(EASES_PER_S * elapsed_s, 0.5)
        of_calm += calms - wakes
        of_moving += wakes + eases - calms - spurs
        of_wild += spurs - eases
        woken = moving if wakes < LEAST_SHARE * of_moving else _mixed(moving, calm, wakes / (of_moving - eases))
        self._filters = [
            _moved(calm, moving, calms / of_calm, elapsed_s, CALM_M2_S3),
            _moved(woken, wild, eases / of_moving, elapsed_s, MOVING_M2_S3),
            _moved(wild, moving, spurs / of_wild, elapsed_s, MANOEUVRE_M2_S3),
        ]
        self._weights = (of_calm, of_moving, of_wild)
        self._combine()

    def update(self, view: View, innovation_m: float, variance_m2: float, other_per_m: float) -> float | None:
        """Take a reading that is ``innovation_m`` longer than expected, where it is of the ground.

        Parameters
        ----------
        view, innovation_m, variance_m2
            What is expected, how much longer the reading is [m], and the variance of its error [m^2].
        other_per_m
            Probability density of readings that are not of the ground [1/m].

        Returns
        -------
        float or None
            The innovation squared over its variance; None where the reading is more likely of something else, and
            nothing has changed.
        """
        _, by_height, by_north, by_east, _ = view
        expected = by_height * self.height_m + by_north * self.rise_north + by_east * self.rise_east + innovation_m
        filters, weights, normalised = [], [], 0.0
        for weight, each in zip(self._weights, self._filters, strict=True):
            # The reading was foretold for the mixture; each filter's own mean is a little off from that.
            own_m = expected - by_height * each[0] - by_north * each[2] - by_east * each[3]
            updated, total_m2 = _updated(each, own_m, by_height, by_north, by_east, variance_m2)
            square = own_m * own_m / total_m2
            filters.append(updated)
            weights.append(weight * math.exp(-0.5 * square) / math.sqrt(total_m2))
            normalised += weight * square
        total = sum(weights)
        if total < other_per_m * SQRT_TWO_PI:
            return None
        self._filters = filters
        self._weights = tuple([max(weight / total, LEAST_WEIGHT) for weight in weights])
        self._combine()
        return normalised

    def shift(self, by_m: float, variance_m2: float, climb_variance: float) -> None:
        """The ground is ``by_m`` lower than thought, as beyond a step; the vehicle's motion stays."""
        self._filters = [
            (each[0] + by_m, *each[1:4], each[4] + variance_m2, *each[5:8], each[8] + climb_variance, *each[9:])
            for each in self._filters
        ]
        self._combine()

    def level(self) -> None:
        """Forget the slope, as where its frame has changed."""
        slope = SLOPE_STD * SLOPE_STD
        self._filters = [
            (each[0], each[1], 0.0, 0.0, each[4], each[5], 0.0, 0.0, each[8], 0.0, 0.0, slope, 0.0, slope)
            for each in self._filters
        ]
        self._combine()

    def ground(self) -> Ground:
        """The mixture's mean and covariance."""
        means = (self.height_m, self.climb_m_s, self.rise_north, self.rise_east)
        covariance = [0.0] * 10
        for weight, each in zip(self._weights, self._filters, strict=True):
            off = [each[i] - means[i] for i in range(4)]
            spread = [off[i] * off[j] for i in range(4) for j in range(i, 4)]
            covariance = [a + weight * (b + c) for a, b, c in zip(covariance, each[4:], spread, strict=True)]
        return Ground(*means, tuple(covariance))

    def variance(self, by_height: float, by_north: float, by_east: float) -> float:
        """Variance of the error of a linear combination of height and slope."""
        total = 0.0
        for weight, each in zip(self._weights, self._filters, strict=True):
            if weight > LEAST_SHARE:
                off = by_height * (each[0] - self.height_m)
                total += weight * (_variance(each, by_height, by_north, by_east) + off * off)
        return total

    def _combine(self) -> None:
        a, b, c = self._weights
        calm, moving, wild = self._filters
        self.height_m = a * calm[0] + b * moving[0] + c * wild[0]
        self.climb_m_s = a * calm[1] + b * moving[1] + c * wild[1]
        self.rise_north = a * calm[2] + b * moving[2] + c * wild[2]
        self.rise_east = a * calm[3] + b * moving[3] + c * wild[3]


def _variance(of: _Gaussian, a: float, b: float, c: float) -> float:
    """a h + b g_n + c g_e."""
    _, _, _, _, hh, _, hn, he, _, _, _, nn, ne, ee = of
    return a * (a * hh + 2 * (b * hn + c * he)) + b * (b * nn + 2 * c * ne) + c * c * ee


def _mixed(own: _Gaussian, other: _Gaussian, share: float) -> _Gaussian:
    """Mean and covariance of a mixture of which ``share`` is the other's."""
    h, w, n, e, hh, hw, hn, he, ww, wn, we, nn, ne, ee = own
    h2, w2, n2, e2, hh2, hw2, hn2, he2, ww2, wn2, we2, nn2, ne2, ee2 = other
    dh, dw = h2 - h, w2 - w
    spread = share * (1 - share)
    # Of the slope the filters know the same, but for little: its means do not spread the mixture.
    return (
        h + share * dh,
        w + share * dw,
        n + share * (n2 - n),
        e + share * (e2 - e),
        hh + share * (hh2 - hh) + spread * dh * dh,
        hw + share * (hw2 - hw) + spread * dh * dw,
        hn + share * (hn2 - hn),
        he + share * (he2 - he),
        ww + share * (ww2 - ww) + spread * dw * dw,
        wn + share * (wn2 - wn),
        we + share * (we2 - we),
        nn + share * (nn2 - nn),
        ne + share * (ne2 - ne),
        ee + share * (ee2 - ee),
    )


def _moved(own: _Gaussian, other: _Gaussian, share: float, t: float, density: float) -> _Gaussian:
    """Mixed, then x' = F x, P' = F P F^T + Q; Q of white acceleration of density q: [[t^3/3, t^2/2], [t^2/2, t]] q."""
    h, w, n, e, hh, hw, hn, he, ww, wn, we, nn, ne, ee = own if share < LEAST_SHARE else _mixed(own, other, share)
    stays = max(1 - t / SLOPE_LASTS_S, 0.0)
    comes = (1 - stays * stays) * SLOPE_STD * SLOPE_STD
    square = stays * stays
    noise = density * t
    return (
        h + w * t,
        w,
        n * stays,
        e * stays,
        hh + t * (2 * hw + t * (ww + noise / 3)),
        hw + t * (ww + noise / 2),
        (hn + t * wn) * stays,
        (he + t * we) * stays,
        ww + noise,
        wn * stays,
        we * stays,
        nn * square + comes,
        ne * square,
        ee * square + comes,
    )


def _updated(
    before: _Gaussian, innovation_m: float, a: float, b: float, c: float, variance_m2: float
) -> tuple[_Gaussian, float]:
    """Kalman update with the row H = (a, 0, b, c); also the innovation's variance."""
    h, w, n, e, hh, hw, hn, he, ww, wn, we, nn, ne, ee = before
    x0, x1 = a * hh + b * hn + c * he, a * hw + b * wn + c * we
    x2, x3 = a * hn + b * nn + c * ne, a * he + b * ne + c * ee
    total_m2 = a * x0 + b * x2 + c * x3 + variance_m2
    k0, k1, k2, k3 = x0 / total_m2, x1 / total_m2, x2 / total_m2, x3 / total_m2
    return (
        (
            h + k0 * innovation_m,
            w + k1 * innovation_m,
            n + k2 * innovation_m,
            e + k3 * innovation_m,
            hh - k0 * x0,
            hw - k0 * x1,
            hn - k0 * x2,
            he - k0 * x3,
            ww - k1 * x1,
            wn - k1 * x2,
            we - k1 * x3,
            nn - k2 * x2,
            ne - k2 * x3,
            ee - k3 * x3,
        ),
        total_m2,
    )
