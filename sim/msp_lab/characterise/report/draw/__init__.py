"""The report's pictures: plain arrays enter, figures leave. Nothing here estimates or judges."""
