"""What a release consists of, and how it is made: ``make release`` (docs/releasing.md)."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
