"""Differences between two implementations of one filter, as changes of a variant, each with a description."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

from msp_lab.filter_study.nine import Variant
from msp_lab.filter_study.scenarios import FIXED_CM

Kind = Literal["q_factor", "noise_factor", "start_cm", "delay", "window", "centred", "boundary", "sign"]

FACTORS = tuple(float(10 ** (eighth / 8)) for eighth in range(-16, 17) if eighth)
"""Factors of a variance that are tried: eight per decade, from 0.01 to 100."""
ROUND = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
"""Numbers, times a power of ten, that an implementation is likely to contain; preferred where they fit as well."""
DELAYS = range(-5, 16)
"""Delays that are tried for a filter without a window [samples]."""
BOUNDARIES = {
    "grow": "at the boundary a shorter window",
    "raw": "at the boundary the reading itself",
    "zero": "zeros beyond the boundary",
    "first": "the outermost reading repeated beyond the boundary",
}


@dataclass(frozen=True)
class ImplementationChange:
    """One difference of an implementation.

    Examples
    --------
    >>> print(ImplementationChange("q_factor", 10.0).text)
    Q times 10 (or R times 0.1: the gain is the same)
    >>> print(ImplementationChange("delay", 3).text)
    3 samples late
    """

    kind: Kind
    value: Any

    def made_in(self, variant: Variant) -> Variant:
        """Return the variant with this change."""
        if self.kind == "sign":
            return replace(variant, reversed=not variant.reversed)
        return replace(variant, **{"parameter" if self.kind == "window" else self.kind: self.value})

    @property
    def text(self) -> str:
        """Description of the change."""
        value = self.value
        if self.kind == "q_factor":
            return f"Q times {value:.4g} (or R times {1 / value:.4g}: the gain is the same)"
        if self.kind == "noise_factor":
            return f"noise of {value:.4g} times the variance"
        if self.kind == "start_cm":
            return f"started at {value:g} cm instead of the first reading"
        if self.kind == "delay":
            return f"{abs(value)} sample{'s' * (abs(value) > 1)} {'late' if value > 0 else 'early'}"
        if self.kind == "window":
            return f"window of {value:g}"
        if self.kind == "centred":
            return "centred: half of the window looks ahead" if value else "causal: the window ends at its reading"
        if self.kind == "boundary":
            return BOUNDARIES[value]
        return "errors of the other sign"

    @property
    def is_factor(self) -> bool:
        """Whether its value may be any positive number."""
        return self.kind in ("q_factor", "noise_factor")


Changes = tuple[ImplementationChange, ...]


def all_made(changes: Changes, variant: Variant) -> Variant:
    """Return the variant with all changes."""
    for change in changes:
        variant = change.made_in(variant)
    return variant


def single(variant: Variant, each_factor: int = 1) -> Iterator[ImplementationChange]:
    """Yield every single change; of factors, every `each_factor`-th."""
    factors = FACTORS[::each_factor]
    if variant.family == "kalman":
        yield from (ImplementationChange("q_factor", factor) for factor in factors)
        yield from (ImplementationChange("start_cm", start_cm) for start_cm in (0.0, FIXED_CM))
        delays: Sequence[int] = DELAYS
    else:
        yield ImplementationChange("centred", not variant.centred)
        yield from (ImplementationChange("boundary", each) for each in BOUNDARIES if each != variant.boundary)
        for window in range(1, 2 * variant.window + 2):
            if window != variant.window and (window % 2 or not variant.centred):
                yield ImplementationChange("window", float(window))
        # Half a window late or early is the same as the other kind of window.
        half = (variant.window - 1) // 2 * (1 if variant.centred else -1)
        delays = [delay for delay in range(-variant.window, 2 * variant.window + 1) if delay != half]
    yield from (ImplementationChange("delay", delay) for delay in delays if delay)
    yield from (ImplementationChange("noise_factor", factor) for factor in factors)
    yield ImplementationChange("sign", None)


def double(base: Variant) -> Iterator[Changes]:
    """Yield every pair of changes of different kinds; of factors, four per decade."""
    for one, other in combinations(single(base, each_factor=2), 2):
        if one.kind != other.kind:
            yield one, other
