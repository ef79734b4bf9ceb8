"""
Ridges: what height and force do to the contact
===============================================

A finger's ridges touch first; with more force they flatten and widen, and new ones come down. Nine presses of a loop
of ridges 100 to 200 um high under 0.5 to 1.5 N, and the contact area against force beside that of a smooth finger.
"""

import matplotlib.pyplot as plt
import numpy as np

import evanesce as ev

heights_um = (100, 150, 200)
forces_N = (0.5, 1.0, 1.5)
ridges = {"pattern": "loop", "pitch_um": 700, "width_um": 350, "orientation_deg": 70}
base = ev.load("thesis_ridged").with_(leds__voltage_V=9.2)

# %%
# One camera for each height; the frames of one row differ in force alone.

cameras = [ev.Camera(base.with_(finger__ridges={**ridges, "height_um": height})) for height in heights_um]
frames = [[camera.shoot(force, seed=1).frame for force in forces_N] for camera in cameras]

# %%
# The contact alone needs no light: ``solve_contact`` returns pressure and gap on the contact plane, here on half as
# many samples along a side.

loads_N = np.linspace(0.1, 2.0, 20)
fingers = {"smooth": None} | {f"{height} µm": {**ridges, "height_um": height} for height in heights_um}
areas = {}
for name, relief in fingers.items():
    scene = base.with_(finger__ridges=relief, grid__samples=512)
    areas[name] = [ev.solve_contact(scene, load).nominal_contact_area for load in loads_N]

# %%
figure = plt.figure(figsize=(12, 6.4), layout="constrained")
left, right = figure.subfigures(1, 2, width_ratios=(1.25, 1))
grid = left.subplots(3, 3, sharex=True, sharey=True)
for i, height in enumerate(heights_um):
    for j, force in enumerate(forces_N):
        axis = grid[i, j]
        axis.imshow(frames[i][j], cmap="gray", vmin=0, vmax=255, extent=cameras[i].extent_mm)
        axis.set(xlim=(-3, 3), ylim=(3, -3), xticks=(-2, 0, 2), yticks=(-2, 0, 2))
        if i == 0:
            axis.set_title(f"{force:g} N")
        if j == 0:
            axis.set_ylabel(f"{height} µm\ny [mm]")
for axis in grid[-1]:
    axis.set_xlabel("x [mm]")
axis = right.subplots()
colours = ["0.35", *plt.colormaps["viridis"]([0.75, 0.45, 0.1])]
for (label, area), colour in zip(areas.items(), colours, strict=True):
    axis.plot(loads_N, area, color=colour, linewidth=2, label=label)
axis.set(xlabel="normal force [N]", ylabel="contact area [mm²]", xlim=(0, 2), ylim=0, title="contact area")
axis.legend(title="ridge height", frameon=False)
axis.grid(alpha=0.3)
plt.show()
