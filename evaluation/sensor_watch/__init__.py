"""Drawn flights for the sensor watch: false findings in many hours, and the time until a fault is found."""
