"""An example package with an effect, a filter and a sensor of its own."""
