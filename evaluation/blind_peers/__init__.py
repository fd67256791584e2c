"""Peers of the gap workflow: other ways to find and name what a simulation lacks, on tables of `evaluation.blind`."""
