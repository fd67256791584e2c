"""Blind flights: the truth is hidden, an effect is on one of four sensors, and the other sensors are the reference."""
