"""The thesis rig at a sixteenth of its pixels: enough for a study to run, too coarse for its figures."""

TINY = {
    "camera.resolution_px": [500, 375],
    "camera.scale_px_per_mm": 14.6,
    "camera.pixel.pitch_um": 12.4,
    "camera.exposure_ms": 0.4,
    "grid.samples": 320,
    "grid.size_mm": 12.8,
}
