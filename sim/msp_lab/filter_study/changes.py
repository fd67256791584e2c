"""What two implementations of one filter may differ in, as changes to a setting, with words for each."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

from msp_lab.filter_study.bands import Setting
from msp_lab.filter_study.scenarios import FIXED_CM

Kind = Literal["q_factor", "noise_factor", "start_cm", "delay", "window", "centred", "boundary", "sign"]

FACTORS = tuple(float(10 ** (eighth / 8)) for eighth in range(-16, 17) if eighth)
"""Of a variance: eight a decade, from a hundredth to a hundred times."""
ROUND = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
"""What people write, and a power of ten times it."""
DELAYS = range(-5, 16)
"""Of a filter without a window [samples]."""
BOUNDARIES = {
    "grow": "at the boundary a window of what there is",
    "raw": "at the boundary the reading itself",
    "zero": "zeros beyond the boundary",
    "first": "the outermost reading repeated beyond the boundary",
}


@dataclass(frozen=True)
class Change:
    """One thing done otherwise.

    Examples
    --------
    >>> print(Change("q_factor", 10.0).text)
    Q times 10 (or R times 0.1: the gain is the same)
    >>> print(Change("delay", 3).text)
    3 samples late
    """

    kind: Kind
    value: Any

    def made_in(self, setting: Setting) -> Setting:
        """The setting with this change."""
        if self.kind == "noise_factor":
            return replace(setting, noise_factor=self.value)
        if self.kind == "sign":
            return replace(setting, reversed=not setting.reversed)
        name = "parameter" if self.kind == "window" else self.kind
        return replace(setting, variant=replace(setting.variant, **{name: self.value}))

    @property
    def text(self) -> str:
        """In words."""
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
        """Whether its value is any positive number."""
        return self.kind in ("q_factor", "noise_factor")


Changes = tuple[Change, ...]


def all_made(changes: Changes, setting: Setting) -> Setting:
    """The setting with all of the changes."""
    for change in changes:
        setting = change.made_in(setting)
    return setting


def single(base: Setting, each_factor: int = 1) -> Iterator[Change]:
    """Every one thing that may differ; of factors, every so many."""
    variant = base.variant
    factors = FACTORS[::each_factor]
    if variant.family == "kalman":
        yield from (Change("q_factor", factor) for factor in factors)
        yield from (Change("start_cm", start_cm) for start_cm in (0.0, FIXED_CM))
        delays: Sequence[int] = DELAYS
    else:
        yield Change("centred", not variant.centred)
        yield from (Change("boundary", each) for each in BOUNDARIES if each != variant.boundary)
        for window in range(1, 2 * variant.window + 2):
            if window != variant.window and (window % 2 or not variant.centred):
                yield Change("window", float(window))
        # Half a window late or early is what the other kind of window is.
        half = (variant.window - 1) // 2 * (1 if variant.centred else -1)
        delays = [delay for delay in range(-variant.window, 2 * variant.window + 1) if delay != half]
    yield from (Change("delay", delay) for delay in delays if delay)
    yield from (Change("noise_factor", factor) for factor in factors)
    yield Change("sign", None)


def double(base: Setting) -> Iterator[Changes]:
    """Every two things of different kinds; of factors, four a decade."""
    for one, other in combinations(single(base, each_factor=2), 2):
        if one.kind != other.kind:
            yield one, other
