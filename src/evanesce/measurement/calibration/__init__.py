"""Camera calibration from a printed checkerboard, and rectification of the plate plane."""
