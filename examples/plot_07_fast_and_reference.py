"""
The fast renderer against the path tracer
=========================================

``Camera`` has two renderers. The reference draws millions of light paths through plate, silicone and lens; the fast one
solves the same transport by closed forms and tables, without noise. Here both render one press of a ridged finger, and
the difference is compared with what the path tracer's noise allows.
"""

import time

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import t as student

import evanesce as ev

# %%
# A small frame, so that the path tracer is done in seconds.

ridges = {"pattern": "loop", "pitch_um": 1000, "width_um": 500, "height_um": 150, "orientation_deg": 70}
scene = ev.coarser(ev.load("thesis_ridged").with_(finger__ridges=ridges), 5)
cameras = {
    "fast": ev.Camera(scene, renderer="fast"),
    "reference": ev.Camera(scene, renderer="reference", samples=256, passes=16),
}

# %%
# Both see the same contact. ``plate_light`` is the radiance that leaves the glass towards the lens, before lens and
# sensor; the reference estimates its variance from independent passes.

shots, seconds = {}, {}
for name, camera in cameras.items():
    camera.shoot(1.0, seed=1)  # compiles kernels, or computes the rig's light fields
    start = time.perf_counter()
    shots[name] = camera.shoot(2.0, seed=1)
    seconds[name] = time.perf_counter() - start
fast, reference = (shots[name].plate_light for name in ("fast", "reference"))
light = np.asarray(fast.radiance)
inside = light > 0.5 * light.max()  # chosen by the picture without noise: the noisy one would favour high values
level = light[inside].mean()
difference = 100 * (light - reference.radiance) / level
noise = 100 * np.sqrt(np.maximum(reference.variance, 0)) / level
mean, standard = difference[inside].mean(), np.sqrt((noise[inside] ** 2).sum()) / inside.sum()
print(f"mean difference over the contact {mean:+.2f} %, standard error {standard:.2f} %")

# %%
# Left: the frame by either renderer. Middle: their difference, and the standard error of the reference. Right: the
# difference of each pixel in the contact over its standard error. If the fast renderer is right, nothing but the path
# tracer's noise is left, and the histogram follows Student's t of one degree of freedom less than there are passes.

half = 42
scale = scene.camera.scale_px_per_mm
extent = tuple(side * (half + 0.5) / scale for side in (-1, 1, 1, -1))


def around_contact(image, mask):
    """Cut a square around the middle of the contact, (2 half + 1, 2 half + 1)."""
    row, column = np.argwhere(mask).mean(axis=0).round().astype(int)
    return image[row - half : row + half + 1, column - half : column + half + 1]


figure = plt.figure(figsize=(13, 6.6), layout="constrained")
grid = figure.add_gridspec(2, 3, width_ratios=(1, 1.2, 1.3))
for row, (name, shot) in enumerate(shots.items()):
    axis = figure.add_subplot(grid[row, 0])
    axis.imshow(around_contact(shot.frame, shot.truth.mask), cmap="gray", vmin=0, vmax=255, extent=extent)
    axis.set(title=f"{name}: {seconds[name]:.1f} s", xlabel="x [mm]", ylabel="y [mm]")
maps = (("fast minus reference", difference, "RdBu_r", -8), ("standard error of the reference", noise, "viridis", 0))
for row, (title, values, colours, low) in enumerate(maps):
    axis = figure.add_subplot(grid[row, 1])
    image = axis.imshow(around_contact(values, inside), cmap=colours, vmin=low, vmax=8, extent=extent)
    axis.set(title=title, xlabel="x [mm]")
    figure.colorbar(image, ax=axis, label="[% of the contact's light]", shrink=0.85)
axis = figure.add_subplot(grid[:, 2])
z = np.linspace(-5, 5, 201)
axis.hist(difference[inside] / noise[inside], bins=50, range=(-5, 5), density=True, color="#3d7dca", alpha=0.6)
axis.plot(z, student.pdf(z, df=15), color="k", linewidth=2, label="Student's t, 15 degrees of freedom")
axis.set(xlabel="difference / standard error [1]", ylabel="density [1]", xlim=(-5, 5))
axis.set_title(f"{inside.sum()} pixels of the contact")
axis.legend(loc="upper right", frameon=False)
axis.margins(y=0.15)
plt.show()
