"""Which rig to build: predicted error of the whole measurement, searched over what may be varied."""
