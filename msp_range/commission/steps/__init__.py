"""The steps of commissioning: each is a function of the session that returns what it found."""
