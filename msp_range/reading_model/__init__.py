"""The reading model: the distribution of a sensor's readings given the true range, from the sensor model file.

`sensor_model` is small, and the bridge loads it. `kernel` has the four kinds of reading, which all other modules use:
`rows`, the distribution of many readings, and `mixture`, the base model, which draws readings and gives their
likelihood. The fit of its parameters is the laboratory's, in `msp_lab.mixture_fit`.
"""
