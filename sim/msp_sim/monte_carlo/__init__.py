"""Many flights of a scenario with random parameters: how often something goes wrong, and in which flight."""
