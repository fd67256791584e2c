"""The base reading model with effects on it: what it draws is what it scores, on arrays of contexts."""
