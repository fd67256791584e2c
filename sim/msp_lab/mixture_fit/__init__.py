"""The fit of the reading model's parameters to measured readings, by maximum likelihood.

`fit` estimates them (`parameters`) with `grid` (the possible readings), `likelihood` and `maximise`; `fit_result` has
errors and intervals, and `pit` the goodness of fit. The model itself is in `msp_range.reading_model`.
"""
