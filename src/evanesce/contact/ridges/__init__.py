"""Ridged fingers: height maps of ridges, the closed form of one ridge, and ridges on a smooth contact."""
