"""Other ways to find and name what a simulation lacks, on the tables of `tests.blind`, beside the gap workflow."""
