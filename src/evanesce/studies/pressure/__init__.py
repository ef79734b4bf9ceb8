"""Pressure from grey levels against the true pressure."""
