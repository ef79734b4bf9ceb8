"""The simulated twin of a photographed checkerboard."""
