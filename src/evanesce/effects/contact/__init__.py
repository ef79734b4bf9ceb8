"""Effects that change load, finger or contact."""
