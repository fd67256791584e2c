"""Filters of one sensor's stream: the gate in front, the chain, and the table of what can be in it."""
