"""The pictures of the page: plain arrays enter, figures leave. Nothing here estimates or judges."""
