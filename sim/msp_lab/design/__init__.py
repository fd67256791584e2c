"""The experiment that decides: the cheapest session for what the gap workflow could not tell apart or test."""
