"""What judges the product and is no test: generators, campaigns, judges, benchmarks and studies. It is not shipped."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""Top folder of the project."""
CONFIGS = ROOT / "configs"
"""Configuration files of the project."""
