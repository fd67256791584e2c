"""Fleets with a known truth: `msp-lab fleet` on them, scored."""
