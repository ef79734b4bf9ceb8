"""The reference renderer: the rig as a Mitsuba scene, its interface BSDF, and the path tracer."""
