"""What a sensor reads, given the truth: the sensor model file, and the mixture that samples, scores and is fitted.

`sensor_model` is light and is what the bridge loads. `kernel` has the four kinds of reading, and all else is made of
it: `rows`, the distribution of many readings; `mixture`, the base model, which samples and scores; and the fit.
`fit` estimates its parameters, by way of `grid` (what a sensor can report), `densities`, `likelihood` and `newton`;
`fit_result` holds errors and intervals, and `pit` the goodness of fit.
"""
