"""The simulated twin of a contact frame: what lights it, what the camera makes of that, and what each cause explains."""
