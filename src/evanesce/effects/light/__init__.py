"""Effects that change the light that leaves the plate towards the camera."""
