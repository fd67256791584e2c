"""Some values of a test's parameter marked slow: the test itself stays in ``make test`` with the other values."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def slow(*values: Any) -> list[Any]:
    """Values that only ``make test-all`` runs."""
    return [pytest.param(value, marks=pytest.mark.slow) for value in values]


def slow_but(quick: Collection[Any], values: Iterable[Any]) -> list[Any]:
    """All values, of which only ``make test-all`` runs those that are not quick."""
    return [value if value in quick else slow(value)[0] for value in values]
