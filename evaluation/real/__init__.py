"""Real measured sets: what is in them by an analysis of its own, and the gap workflow on each by its commands."""
