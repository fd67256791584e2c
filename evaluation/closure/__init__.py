"""How much of a gap is closed, without the workflow's own measure: a classifier, and KS by slice of context."""
