"""From readings to a sensor model: campaigns at the bench, analyses of their readings, and what they found."""
