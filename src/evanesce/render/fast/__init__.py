"""The fast renderer: fields computed once per rig, operators per contact state, fused kernels."""
