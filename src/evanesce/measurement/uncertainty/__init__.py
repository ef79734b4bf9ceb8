"""Uncertainty of a measured area after the GUM: budget, evaluation for one frame, table."""
