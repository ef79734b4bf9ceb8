"""The real pipeline: frames to area. It knows nothing of the simulation and runs unchanged on real video."""
