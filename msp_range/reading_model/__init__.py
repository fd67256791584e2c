"""The reading model: the distribution of a sensor's readings given the true range, from the sensor model file.

`sensor_model` is small, and the bridge loads it. `kernel` has the four kinds of reading, which all other modules use:
`rows`, the distribution of many readings; `mixture`, the base model, which draws readings and gives their likelihood;
and the fit. `fit` estimates the parameters with `grid` (the possible readings), `likelihood` and
`maximise`; `fit_result` has errors and intervals, and `pit` the goodness of fit.
"""
