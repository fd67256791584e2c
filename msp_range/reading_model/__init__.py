"""What a sensor reads, given the truth: the sensor model file, and the mixture that samples, scores and is fitted.

`sensor_model` is light and is what the bridge loads; the others bring scipy. `mixture` samples and scores readings;
`fit` estimates its parameters, by way of `grid` (what a sensor can report), `densities`, `likelihood` and `newton`;
`fit_result` holds errors and intervals, and `pit` the goodness of fit.
"""
