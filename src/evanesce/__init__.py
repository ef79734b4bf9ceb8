"""evanesce: a physical simulation of an optical tactile rig, read back through its real measurement pipeline.

Lengths are mm, forces N, pressures MPa, times s, angles rad, powers W, wavelengths nm, charges e-, digital values DN.
Any other unit stands in the name. Arrays are indexed ``[row, col]``; integer coordinates are pixel centres; x points
right and y down, in the image as on the plate.
"""

__version__ = "0.2.0"
