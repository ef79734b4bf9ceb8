"""The simulated twin of a contact frame: what lights it, what the camera makes of it, what each cause explains."""
