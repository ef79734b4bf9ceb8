"""Lens, pixel, readout and codec: from radiance to a digital frame."""
