"""Light from the plate towards the lens: path tracer and fast renderer; only this package imports Mitsuba, Dr.Jit."""
