"""The joint fit as a calibration: every figure of a rig that a bundle determines, with intervals, in one scene."""
