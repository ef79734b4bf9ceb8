"""The whole chain from rig to digital frame, in physical order; and the same chain for thousands of frames."""
