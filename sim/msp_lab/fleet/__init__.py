"""Many vehicles at once: which share an effect, which are odd ones out, and what changed over time."""
