"""Height over the ground, its rate, and the ground's slope: an extended Kalman filter for three ways to move.

Height h [m] moves with its rate w [m/s], and w by white acceleration. Three such filters run side by side, for a
quiet vehicle, one in cruise and one that manoeuvres; they are mixed by how well each predicts the readings
(interacting multiple models: Blom and Bar-Shalom, IEEE Transactions on Automatic Control 33, 1988).

The ground's rise per metre north and east, g, is common to the three. Where the sensors that see the ground do not span
a plane, g is a consider state (Schmidt, Advances in Control Systems 3, 1966): its uncertainty counts in every gain and
variance, with its covariance to height and rate, but no reading changes it. Otherwise a vehicle that sways while it
climbs would learn a slope from its own motion. So what no sensor sees stays uncertain: one sensor at a corner knows the
height there and not below the vehicle's middle. Plain floats: for so few that is quicker than arrays.
"""

import math

from msp_range.fusion.mounting import View
from msp_range.fusion.vertical import Rate

QUIET_M2_S3, CRUISE_M2_S3, MANOEUVRE_M2_S3 = 3e-5, 1e-2, 0.8
"""Spectral density of the vehicle's acceleration [m^2/s^3]: at a steady rate; bobbing; changing its speed by a metre a
second within a second."""
MEASURED_M2_S3 = 0.1
"""The last one where the vehicle's acceleration is measured: what is left is the ground's, and the accelerometer's."""
QUIET_TO_CRUISE_PER_S, CRUISE_TO_QUIET_PER_S = 0.03, 0.2
"""How often a quiet vehicle begins to move, and one in cruise becomes quiet [1/s]."""
CRUISE_TO_MANOEUVRE_PER_S, MANOEUVRE_TO_CRUISE_PER_S = 0.2, 0.7
"""How often one in cruise begins a manoeuvre, and ends it [1/s]."""
LONGEST_S = 1.0
"""Longer than this without a reading changes no more of how the vehicle moves [s]."""
START_WEIGHTS = (0.2, 0.4, 0.4)
"""Of the three ways at the beginning."""
SLOPE_STD = 0.10
"""Standard deviation of the ground's rise a metre: 6 deg."""
SLOPE_LASTS_S = 30.0
"""Time constant with which the slope falls back to level where no reading holds it [s]."""
QUIET_M_S2, QUIET_STD_M_S2 = 0.6, 0.3
"""A quiet vehicle has no measured acceleration much beyond the first, by a normal distribution of the second [m/s^2]:
twice an accelerometer's noise, and once. Smaller leaves the quiet filter for vibration, larger lets it lag behind a
vehicle that is read twice a second."""
LEAST_SHARE = 1e-3
"""A filter is not mixed with less than this of another."""
LEAST_WEIGHT = 1e-4
"""No way to move is ever ruled out further than this."""
SQRT_TWO_PI = math.sqrt(2 * math.pi)

_Motion = tuple[float, float, float, float, float, float, float, float, float]
"""Means of one filter, their covariance, and that with the slope: h, w, hh, hw, ww, hn, he, wn, we."""


class GroundFilter:
    """The three filters, their mixture, and the slope.

    Parameters
    ----------
    height_m, variance_m2
        Height by the first reading, over level ground [m], and the variance of its error [m^2].
    climb
        How fast the vehicle climbs.
    lever_m
        How far north and east of the reference point that reading is of the ground [m].

    Attributes
    ----------
    height_m, climb_m_s
        Height of the reference point above the plane of the ground, straight up, and how fast it grows, the mean of the
        three [m, m/s].
    rise_north, rise_east
        Rise of the ground per metre; forward and right where the attitude is not known.
    """

    def __init__(
        self, height_m: float, variance_m2: float, climb: Rate, lever_m: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        # h = H + lever . g, H what was read.
        slope_m2 = SLOPE_STD * SLOPE_STD
        north, east = lever_m
        hh = variance_m2 + (north * north + east * east) * slope_m2
        start: _Motion = (
            height_m, climb.m_s, hh, 0.0, climb.variance, north * slope_m2, east * slope_m2, 0.0, 0.0
        )  # fmt: skip
        self._filters: tuple[_Motion, ...] = (start, start, start)
        self._weights: tuple[float, ...] = START_WEIGHTS
        self.height_m, self.climb_m_s = start[:2]
        self.rise_north = self.rise_east = 0.0
        self._slope = (slope_m2, 0.0, slope_m2)

    def level(self) -> None:
        """Forget the slope, as where its frame has changed."""
        self.rise_north = self.rise_east = 0.0
        self._slope = (SLOPE_STD * SLOPE_STD, 0.0, SLOPE_STD * SLOPE_STD)
        self._filters = tuple([(*motion[:5], 0.0, 0.0, 0.0, 0.0) for motion in self._filters])

    def tilt(self, lower_m: float, rise_north: float, rise_east: float) -> None:
        """The ground has another slope than thought, and is ``lower_m`` lower below the reference point."""
        self.level()
        self.rise_north, self.rise_east = rise_north, rise_east
        self.shift(lower_m, 0.0, 0.0)

    def predict(self, t: float, up_m_s2: float | None = None) -> None:
        """Move on by ``t`` [s]: mix each filter with its neighbours, then let each move in its own way.

        Where the vehicle's acceleration ``up_m_s2`` is measured, the two filters of a vehicle that moves take it; the
        one that is quiet does not, since it would only add the accelerometer's noise.
        """
        if t <= 0:
            return
        quiet, cruise, manoeuvre = self._filters
        of_quiet, of_cruise, of_manoeuvre = self._weights
        manoeuvre_m2_s3 = MANOEUVRE_M2_S3 if up_m_s2 is None else MEASURED_M2_S3
        up_m_s2 = up_m_s2 or 0.0
        if abs(up_m_s2) > QUIET_M_S2:
            of_quiet, of_cruise, of_manoeuvre = _rather_not_quiet(up_m_s2, of_quiet, of_cruise, of_manoeuvre)
        change_s = t if t < LONGEST_S else LONGEST_S
        to_cruise = of_quiet * QUIET_TO_CRUISE_PER_S * change_s
        to_quiet = of_cruise * CRUISE_TO_QUIET_PER_S * change_s
        to_manoeuvre = of_cruise * CRUISE_TO_MANOEUVRE_PER_S * change_s
        from_manoeuvre = of_manoeuvre * MANOEUVRE_TO_CRUISE_PER_S * change_s
        of_quiet += to_quiet - to_cruise
        of_cruise += to_cruise + from_manoeuvre - to_quiet - to_manoeuvre
        of_manoeuvre += to_manoeuvre - from_manoeuvre
        # A quiet vehicle's filter takes hardly anything of the next one; that one takes from both sides.
        cruise_after = _mixed(cruise, quiet, to_cruise / (of_cruise - from_manoeuvre))
        stays = max(1 - t / SLOPE_LASTS_S, 0.0)
        self._filters = (
            _moved(_mixed(quiet, cruise, to_quiet / of_quiet), t, QUIET_M2_S3, 0.0, stays),
            _moved(_mixed(cruise_after, manoeuvre, from_manoeuvre / of_cruise), t, CRUISE_M2_S3, up_m_s2, stays),
            _moved(_mixed(manoeuvre, cruise, to_manoeuvre / of_manoeuvre), t, manoeuvre_m2_s3, up_m_s2, stays),
        )
        self._weights = (of_quiet, of_cruise, of_manoeuvre)
        self._combine()
        square = stays * stays
        comes = (1 - square) * SLOPE_STD * SLOPE_STD
        nn, ne, ee = self._slope
        self._slope = (nn * square + comes, ne * square, ee * square + comes)
        self.rise_north *= stays
        self.rise_east *= stays

    def update(self, view: View, innovation_m: float, variance_m2: float, learns_slope: bool = True) -> float:
        """Update with a reading that is ``innovation_m`` longer than expected.

        With H = (a, 0, b, c) the derivatives of the reading and x = (h, w, g), each filter's gain of h and w is
        K = P H^T / S, S = H P H^T + R. That of g is the same, of the mixture's means, or 0 where g is only considered;
        the covariance of h and w with g falls by K H P in both cases. As g is common to the three, what one of them has
        in common with it may come to be more than g's own variance leaves; S is then as much as keeps P positive, R
        and P H^T weighed by the inverse of P.

        Parameters
        ----------
        view, innovation_m, variance_m2
            What is expected, how much longer the reading is [m], and the variance of its error [m^2].
        learns_slope
            Whether the sensors that see the ground span a plane.

        Returns
        -------
        float
            The innovation squared over its variance.
        """
        a, b, c = view[1:4]
        nn, ne, ee = self._slope
        updated: list[_Motion] = []
        likelihoods = []
        normalised = total_m2 = slope_n = slope_e = 0.0
        expected_m = innovation_m + a * self.height_m
        for weight, (h, w, hh, hw, ww, hn, he, wn, we) in zip(self._weights, self._filters, strict=True):
            ph, pw = a * hh + b * hn + c * he, a * hw + b * wn + c * we
            pn, pe = a * hn + b * nn + c * ne, a * he + b * ne + c * ee
            # The reading was predicted for the mixture; each filter's own mean is a little off from that.
            own_m, own_m2 = expected_m - a * h, a * ph + b * pn + c * pe + variance_m2
            least_m2 = variance_m2 + _weighed(ph, pw, hh, hw, ww)
            own_m2 = least_m2 if least_m2 > own_m2 else own_m2
            k, j = ph / own_m2, pw / own_m2
            h, w, hh, hw, ww = h + k * own_m, w + j * own_m, hh - k * ph, hw - k * pw, ww - j * pw
            updated.append((h, w, hh, hw, ww, hn - k * pn, he - k * pe, wn - j * pn, we - j * pe))
            square = own_m * own_m / own_m2
            likelihoods.append(weight * math.exp(-0.5 * square) / math.sqrt(own_m2))
            normalised += weight * square
            total_m2 += weight * own_m2
            slope_n += weight * pn
            slope_e += weight * pe
        total = sum(likelihoods)
        least = LEAST_WEIGHT * total
        self._weights = tuple([each / total if each > least else LEAST_WEIGHT for each in likelihoods])
        self._filters = tuple(updated)
        if learns_slope:
            total_m2 = max(total_m2, variance_m2 + _weighed(slope_n, slope_e, nn, ne, ee))
            k_north, k_east = slope_n / total_m2, slope_e / total_m2
            self.rise_north += k_north * innovation_m
            self.rise_east += k_east * innovation_m
            self._slope = (nn - k_north * slope_n, ne - k_north * slope_e, ee - k_east * slope_e)
        self._combine()
        return normalised

    def density(self, view: View, innovation_m: float, variance_m2: float) -> float:
        """Probability density of a reading that is ``innovation_m`` longer than expected [1/m]; see `update`."""
        a, b, c = view[1:4]
        nn, ne, ee = self._slope
        slope_m2 = b * b * nn + 2 * b * c * ne + c * c * ee + variance_m2
        expected_m = innovation_m + a * self.height_m
        total = 0.0
        for weight, (h, _, hh, _, _, hn, he, _, _) in zip(self._weights, self._filters, strict=True):
            own_m, own_m2 = expected_m - a * h, a * (a * hh + 2 * (b * hn + c * he)) + slope_m2
            own_m2 = variance_m2 if variance_m2 > own_m2 else own_m2
            total += weight * math.exp(-0.5 * own_m * own_m / own_m2) / math.sqrt(own_m2)
        return total / SQRT_TWO_PI

    def shift(self, by_m: float, variance_m2: float, climb_variance: float) -> None:
        """The ground is ``by_m`` lower than thought, as beyond a step; the vehicle's motion stays."""
        self._filters = tuple(
            [
                (h + by_m, w, hh + variance_m2, hw, ww + climb_variance, hn, he, wn, we)
                for h, w, hh, hw, ww, hn, he, wn, we in self._filters
            ]
        )
        self._combine()

    def variance(self, by_height: float, by_north: float, by_east: float) -> float:
        """Variance of the error of a linear combination of height and slope, the filters' differences included."""
        nn, ne, ee = self._slope
        total = by_north * by_north * nn + 2 * by_north * by_east * ne + by_east * by_east * ee
        for weight, (h, _, hh, _, _, hn, he, _, _) in zip(self._weights, self._filters, strict=True):
            off_m = h - self.height_m
            cross = 2 * (by_north * hn + by_east * he)
            total += weight * by_height * (by_height * (hh + off_m * off_m) + cross)
        return total

    def _combine(self) -> None:
        a, b, c = self._weights
        quiet, cruise, manoeuvre = self._filters
        self.height_m = a * quiet[0] + b * cruise[0] + c * manoeuvre[0]
        self.climb_m_s = a * quiet[1] + b * cruise[1] + c * manoeuvre[1]


def _rather_not_quiet(
    up_m_s2: float, of_quiet: float, of_cruise: float, of_manoeuvre: float
) -> tuple[float, float, float]:
    """The weights, given an acceleration that a quiet vehicle does not have."""
    over = (abs(up_m_s2) - QUIET_M_S2) / QUIET_STD_M_S2
    of_quiet = max(of_quiet * math.exp(-0.5 * over * over), LEAST_WEIGHT)
    total = of_quiet + of_cruise + of_manoeuvre
    return of_quiet / total, of_cruise / total, of_manoeuvre / total


def _weighed(p: float, q: float, pp: float, pq: float, qq: float) -> float:
    """(p, q) P^-1 (p, q)^T, P = [[pp, pq], [pq, qq]]: P - (p, q)^T (p, q) / s is positive where s is more than that."""
    return (qq * p * p - 2 * pq * p * q + pp * q * q) / (pp * qq - pq * pq)


def _mixed(own: _Motion, other: _Motion, share: float) -> _Motion:
    """Mean and covariance of a mixture of which ``share`` is the other's; of a very small share nothing."""
    if share <= LEAST_SHARE:
        return own
    h, w, hh, hw, ww, hn, he, wn, we = own
    h2, w2, hh2, hw2, ww2, hn2, he2, wn2, we2 = other
    dh, dw, rest = h2 - h, w2 - w, 1 - share
    return (
        h + share * dh,
        w + share * dw,
        hh + share * (hh2 - hh + rest * dh * dh),
        hw + share * (hw2 - hw + rest * dh * dw),
        ww + share * (ww2 - ww + rest * dw * dw),
        hn + share * (hn2 - hn),
        he + share * (he2 - he),
        wn + share * (wn2 - wn),
        we + share * (we2 - we),
    )


def _moved(own: _Motion, t: float, density: float, up_m_s2: float, stays: float) -> _Motion:
    """x' = F x + (t^2/2, t) a, P' = F P F^T + Q; a the measured acceleration, the slope falls to ``stays`` of itself.

    Q is that of white acceleration of density q: [[t^3/3, t^2/2], [t^2/2, t]] q.
    """
    h, w, hh, hw, ww, hn, he, wn, we = own
    noise = density * t
    change_m_s = up_m_s2 * t
    return (
        h + (w + 0.5 * change_m_s) * t,
        w + change_m_s,
        hh + t * (2 * hw + t * (ww + noise / 3)),
        hw + t * (ww + noise / 2),
        ww + noise,
        (hn + t * wn) * stays,
        (he + t * we) * stays,
        wn * stays,
        we * stays,
    )
