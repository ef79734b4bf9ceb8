"""
Effects: vignetting, dust and defocus
=====================================

A real rig departs from the ideal one. Each departure is an effect: a table of the scene, whose function receives the
light, the charge or the frame and changes it. At its null value an effect is absent bit for bit.
"""

import matplotlib.pyplot as plt

import evanesce as ev

# %%
# All effects that evanesce knows, by the stage at which they act:

for stage in dict.fromkeys(effect.stage for effect in ev.all_effects().values()):
    print(f"{stage.name.lower():12}", *(name for name, effect in ev.all_effects().items() if effect.stage is stage))

# %%
# Three effects of the camera, one at a time. On the calibration target, lit all over, they are seen at once; a press
# shows what they do to the contact and its area.

effects = {
    "ideal": {},
    "vignetting": {"vignetting": {"k": 0.7}},
    "dust on the sensor": {"sensor_dust": {"per_cm2": 300.0, "median_diameter_um": 90.0, "height_mm": 0.6}},
    "defocus": {"defocus": {"blur_um": 16.0}},
}
ridges = {"pattern": "loop", "pitch_um": 700, "width_um": 350, "height_um": 150, "orientation_deg": 70}
scene = ev.coarser(ev.load("thesis_ridged").with_(leds__voltage_V=9.2, finger__ridges=ridges), 2)
cameras = {name: ev.Camera(scene.with_(effects=table)) for name, table in effects.items()}

# %%
figure, axes = plt.subplots(2, 4, figsize=(13, 6), height_ratios=(0.8, 1), layout="constrained")
for column, (name, camera) in enumerate(cameras.items()):
    above, below = axes[:, column]
    above.imshow(camera.shoot_target("checkerboard", seed=1), cmap="gray", vmin=0, vmax=255, extent=camera.extent_mm)
    above.set(title=name, xlabel="x [mm]")
    shot = camera.shoot(1.5, seed=1)
    found = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.3, min_blob_px=500)
    below.imshow(shot.frame, cmap="gray", vmin=0, vmax=255, extent=camera.extent_mm)
    below.contour(
        shot.truth.coverage, levels=[0.5], colors="#3d9dff", linewidths=0.8, extent=camera.extent_mm, origin="upper"
    )
    error = ev.compare(found, shot).error_percent
    below.set(xlim=(-3, 3), ylim=(3, -3), xlabel="x [mm]", title=f"area error {error:+.1f} %")
for axis in axes[:, 0]:
    axis.set_ylabel("y [mm]")
plt.show()
