"""
A slide: where the skin sticks and where it slips
=================================================

A ridged finger is pressed on the glass and pulled sideways. Slip begins at the rim of the contact and grows inwards
until the whole finger slides. Every sample carries the frame and, pixel by pixel, the state of the skin.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

import evanesce as ev

# %%
# ``make_dataset`` makes labelled trials in memory; keys of its configuration are changed like those of a scene. Here
# one slide of one finger: a declared distribution may be a constant.

samples = ev.make_dataset(
    ev.load("thesis").with_(leds__voltage_V=9.2),
    trials=1,
    seed=4,
    trial={"frames": 32, "frame_rate_hz": 15.0},
    kinds={"slide": 1, "load_stop": 0, "wiggle": 0, "rotation": 0, "ramp": 0, "release": 0, "change": 0},
    programme__normal_force_N={"constant": 1.5},
    programme__press_time_s={"constant": 0.4},
    programme__speed_mm_per_s={"constant": 2.0},
    programme__distance_mm={"constant": 2.6},
    programme__direction_deg={"constant": 0.0},
    friction__friction_coefficient={"constant": 0.8},
    finger__material={"constant": "silskin_0"},
    finger__ridged_share=1.0,
    finger__pattern={"choice": ["loop"]},
    finger__ridge_pitch_um={"constant": 700.0},
    finger__ridge_height_um={"constant": 150.0},
    finger__ridge_orientation_deg={"constant": 70.0},
    finger__shaft_stiffness_N_per_mm={"constant": 3.0},
    rig__draw={},
    randomisation__probability=0.0,
    camera__scale=0.5,
)
slide = list(samples)
time_s, force_N, stick = (
    np.array([sample.scalars[name] for sample in slide]) for name in ("time_s", "Fx_N", "stick_ratio")
)

# %%
# Six instants: all stuck, slip from the rim inwards, full slip, and the finger a millimetre further. Below, the
# tangential force that rises until the finger slides, and the share of the contact that sticks.

instants = [int(np.argmax(stick <= share)) for share in (0.999, 0.8, 0.5, 0.2, 0.0)]
instants = [instants[0] - 1, *instants[1:], instants[-1] + 9]
colours = ["black", "#39415c", "#3d7dca", "#ff8c1a"]
extent = ev.Camera(ev.coarser(ev.load("thesis"), 2)).extent_mm
figure = plt.figure(figsize=(13, 6.6), layout="constrained")
grid = figure.add_gridspec(3, len(instants), height_ratios=(1, 1, 0.75))
for column, index in enumerate(instants):
    frame, labels = figure.add_subplot(grid[0, column]), figure.add_subplot(grid[1, column])
    frame.imshow(slide[index].frame, cmap="gray", vmin=0, vmax=255, extent=extent)
    frame.set_title(f"{time_s[index]:.2f} s")
    labels.imshow(slide[index].state, cmap=ListedColormap(colours), vmin=-0.5, vmax=3.5, extent=extent)
    for axis in (frame, labels):
        axis.set(xlim=(-3.8, 3.0), ylim=(3.4, -3.4), xticks=(-2, 0, 2), yticks=(-2, 0, 2))
        axis.tick_params(labelleft=column == 0, labelbottom=axis is labels)
    labels.set_xlabel("x [mm]")
    if column == 0:
        frame.set_ylabel("frame\ny [mm]")
        labels.set_ylabel("labels\ny [mm]")
names = [Patch(color=colour) for colour in colours[1:]]
labels.legend(names, ["near", "stick", "slip"], loc="lower left", fontsize=8, framealpha=0.85)
axis = figure.add_subplot(grid[2, :])
share = axis.twinx()
share.fill_between(time_s, stick, color=colours[2], alpha=0.4, linewidth=0)
share.fill_between(time_s, stick, 1, color=colours[3], alpha=0.4, linewidth=0)
share.set(ylabel="share that sticks [1]", ylim=(0, 1))
axis.plot(time_s, force_N, color="k", linewidth=2)
axis.set(xlabel="time [s]", ylabel="tangential force [N]", xlim=(0, time_s[-1]), ylim=0)
axis.set_zorder(1)
axis.patch.set_visible(False)
for index in instants:
    axis.axvline(time_s[index], color="0.2", linewidth=0.8, linestyle=":")
plt.show()
