"""Least squares with errors by cluster, and how well a form predicts clusters that were left out."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluation.real.columns import FloatArray


@dataclass(frozen=True)
class Line:
    """A form fitted to residuals."""

    value: FloatArray
    error: FloatArray
    """Of each term; the error is the sandwich estimate by cluster."""
    left_out_rms: float
    """Root mean square of what it does not predict in clusters that were left out of the fit."""
    rest: FloatArray
    """What it leaves of all rows."""


def regress(y: FloatArray, terms: Sequence[FloatArray], cluster: NDArray[np.generic]) -> Line:
    """Fit a constant and terms.

    Parameters
    ----------
    y
        Residuals, one a row.
    terms
        Columns of the same length.
    cluster
        Rows of one cluster may depend on each other; whole clusters are left out for `left_out_rms`.
    """
    design = np.column_stack([np.ones(y.size), *terms])
    value = np.linalg.lstsq(design, y, rcond=None)[0]
    rest = y - design @ value
    names = np.unique(cluster)
    sums = np.array([design[cluster == name].T @ rest[cluster == name] for name in names])
    inverse = np.linalg.pinv(design.T @ design)
    variance = inverse @ (sums.T @ sums) @ inverse * names.size / max(names.size - 1, 1)
    predicted = np.empty(y.size)
    for name in names:
        out = cluster == name
        predicted[out] = design[out] @ np.linalg.lstsq(design[~out], y[~out], rcond=None)[0]
    return Line(value, np.sqrt(np.diag(variance)), float(np.sqrt(np.mean((y - predicted) ** 2))), rest)


def print_forms(
    y: FloatArray,
    forms: Mapping[str, Sequence[FloatArray]],
    cluster: NDArray[np.generic],
    base: Sequence[FloatArray] = (),
) -> None:
    """Each form on top of `base`: rms in left-out clusters, and the last term with its error."""
    for name, terms in forms.items():
        line = regress(y, [*base, *terms], cluster)
        last = f", {line.value[-1]:.3g} ({line.error[-1]:.2g})" if [*base, *terms] else ""
        print(f"    {name}: rms in left-out clusters {line.left_out_rms:.3f}{last}")


def hinges(x: FloatArray, knots: Sequence[float]) -> list[FloatArray]:
    """Terms of a piecewise straight line."""
    return [x, *(np.maximum(x - knot, 0.0) for knot in knots)]


def autocorrelation(x: FloatArray, lags: Sequence[int] = (1, 2, 5, 10)) -> str:
    """At some lags, as text."""
    x = x - x.mean()
    return ", ".join(f"{lag}: {np.mean(x[lag:] * x[:-lag]) / np.mean(x * x):.2f}" for lag in lags)


def smooth_rate(z: FloatArray, t: FloatArray) -> FloatArray:
    """Rate of the truth, smoothed over five rows."""
    found: FloatArray = np.gradient(np.convolve(np.pad(z, 2, mode="edge"), np.ones(5) / 5.0, "valid"), t)
    return found


def robust_sd(x: FloatArray) -> float:
    """Standard deviation by the median of absolute deviations."""
    return float(1.4826 * np.median(np.abs(x - np.median(x))))


def print_bins(name: str, x: FloatArray, y: FloatArray, edges: Sequence[float]) -> None:
    """Median and robust spread of `y` in bins of `x`."""
    cells = []
    for low, high in itertools.pairwise(edges):
        here = (x >= low) & (x < high)
        if here.sum() > 5:
            cells.append(f"{low:g}-{high:g}: {np.median(y[here]):.2f} ({robust_sd(y[here]):.2f}; n {here.sum()})")
    print(f"    by {name}, median (robust sd): " + "; ".join(cells))


def print_jumps(where: str, jumps_cm: FloatArray) -> None:
    """Step into which jumps between readings fall: best step, mean cosine of the phase, and that in its errors."""
    jumps_cm = jumps_cm[(np.abs(jumps_cm) > 0.2) & (np.abs(jumps_cm) < 2.5)]
    steps = np.arange(0.3, 1.2, 0.005)
    phase = [np.cos(2.0 * np.pi * jumps_cm / step) for step in steps]
    best = int(np.argmax([each.mean() for each in phase]))
    error = phase[best].std() / np.sqrt(jumps_cm.size)
    cosine = phase[best].mean()
    print(f"    jumps {where}: steps of {steps[best]:.3f} cm (mean cosine {cosine:.2f}, z {cosine / error:.0f})")
