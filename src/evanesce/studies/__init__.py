"""Studies that run the whole chain: demo, twin, threshold, voltage, accuracy."""
