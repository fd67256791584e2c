"""The steps of commissioning in their order: each is a function of the session that returns what it found."""
