"""Effects of pixel, readout, tone curve and codec."""
