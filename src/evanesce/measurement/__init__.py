"""Measurement of contact area from frames; independent of the simulation, for real and simulated frames alike."""
