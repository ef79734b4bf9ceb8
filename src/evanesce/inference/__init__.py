"""Inference of what a simulation gets wrong: many causes fitted jointly to measured data."""
