"""
Contact laws: Hertz, adhesion, finite elements
==============================================

How a silicone finger spreads on glass is a choice of the scene: closed forms of a sphere without and with adhesion, a
power law of soft fingers, or finite elements of the whole finger, from the library of solved presses that ships with
evanesce.
"""

import matplotlib.pyplot as plt
import numpy as np

import evanesce as ev

base = ev.load("thesis")
scenes = {
    "Hertz": base,
    "JKR, 0.1 J/m²": base.with_(contact={"law": "jkr", "work_of_adhesion_N_per_mm": 1e-4}),
    "Xydas and Kao": base.with_(contact={"law": "xydas_kao", "c_mm": 1.95, "gamma": 0.28}),
    "finite elements": base.with_(contact={"law": "fem", "bone": "none"}),
}

# %%
# Area against force. A contact is solved without any light.

loads_N = np.geomspace(0.1, 5.0, 16)
areas = {
    name: [ev.solve_contact(scene, load).nominal_contact_area for load in loads_N] for name, scene in scenes.items()
}

# %%
# Pressure under 2 N, along a line through the middle of the contact. JKR's adhesion pulls at the rim, where the
# pressure of the model is negative and unbounded.

profiles = {}
for name, scene in scenes.items():
    state = ev.solve_contact(scene, 2.0)
    profiles[name] = state.grid.x, 1e3 * np.asarray(state.pressure)[state.grid.shape[0] // 2]

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.8), layout="constrained")
colours = ["#3d7dca", "#2ca02c", "#ff8c1a", "#8e44ad"]
for (name, area), colour in zip(areas.items(), colours, strict=True):
    left.loglog(loads_N, area, color=colour, linewidth=2, label=name)
    right.plot(*profiles[name], color=colour, linewidth=2, label=name)
left.set(
    xlabel="normal force [N]", ylabel="contact area [mm²]", title="area against force", xlim=(0.1, 5), ylim=(2, 60)
)
left.set_xticks([0.1, 0.2, 0.5, 1, 2, 5], labels=["0.1", "0.2", "0.5", "1", "2", "5"])
left.set_yticks([2, 5, 10, 20, 50], labels=["2", "5", "10", "20", "50"])
left.minorticks_off()
left.legend(frameon=False)
right.axhline(0, color="k", linewidth=0.8)
right.set(xlabel="x [mm]", ylabel="contact pressure [kPa]", title="pressure under 2 N", xlim=(-3.2, 3.2))
right.set_ylim(bottom=-60)
for axis in (left, right):
    axis.grid(alpha=0.3)
plt.show()
