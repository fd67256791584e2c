"""Other ways to find and name what a simulation lacks, on the tables of `tests.blind`, alongside the gap workflow."""
