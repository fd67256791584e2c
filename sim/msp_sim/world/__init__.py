"""Where the vehicle flies and how: surfaces, air, motion, profiles over time."""
