"""Criticism: from measured data to what the simulation gets wrong."""
