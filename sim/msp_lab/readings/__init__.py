"""Readings of sensors, whoever made them: column names and units, files together as one table."""
