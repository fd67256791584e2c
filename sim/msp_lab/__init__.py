"""Laboratory of msp_range: what is learnt from readings, measured or simulated."""
