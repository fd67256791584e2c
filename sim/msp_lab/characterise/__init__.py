"""From readings to a sensor model: analyses of readings at known ranges, and what they found."""
