"""Filters of one sensor's stream: the status gate, the chain, and the table of filters."""
