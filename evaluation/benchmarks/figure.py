"""A figure of a benchmark and its goal."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Figures = list[dict[str, Any]]
"""Figures as {key, value, unit, goal, met}; goal and met are None where there is no goal."""


@dataclass(frozen=True)
class Goal:
    """What a value has to be: in words, and whether it is."""

    text: str
    holds: Callable[[float], bool]


def at_most(limit: float) -> Goal:
    """A value that is not larger."""
    return Goal(f"at most {limit:g}", lambda value: value <= limit)


def at_least(limit: float) -> Goal:
    """A value that is not smaller."""
    return Goal(f"at least {limit:g}", lambda value: value >= limit)


def under(limit: float) -> Goal:
    """A value that is smaller."""
    return Goal(f"under {limit:g}", lambda value: value < limit)


def figure(key: str, value: float, unit: str, goal: Goal | None = None) -> dict[str, Any]:
    """A figure, in four digits."""
    met = None if goal is None else bool(goal.holds(value))
    return {
        "key": key,
        "value": float(f"{value:.4g}"),
        "unit": unit,
        "goal": None if goal is None else goal.text,
        "met": met,
    }
