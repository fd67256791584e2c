"""The reading model with effects: draws readings and gives their likelihood, for arrays of contexts."""
