"""The gap workflow: where a model and measured readings disagree, what is missing, and whether adding it helps."""
