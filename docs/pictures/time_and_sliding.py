"""Draw the pictures of docs/validation/viscoelastic.md and sliding.md: ``python docs/pictures/time_and_sliding.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from evanesce.bench.dma import prony_of
from evanesce.bench.friction import spectrum
from evanesce.contact.analytic.viscoelastic import press_by_force, reduced_series
from evanesce.contact.sliding.area_loss import area_loss_for
from evanesce.contact.sliding.programme import SlideProgramme, press_and_slide
from evanesce.contact.sliding.stick_slip import Slider, simulate_stick_slip, stick_slip_period
from evanesce.core.states import PlateGrid
from evanesce.materials.friction import InterfaceFriction, interface_of
from evanesce.materials.tables import material
from evanesce.report.html import figure_png

HERE = Path(__file__).resolve().parent
LABELS = ListedColormap(["#f4f4f4", "#c8d6e5", "#1f4e79", "#e07b39"])


def sliding() -> Figure:
    """Four instants of a slide, and force, area and stick ratio against the drive's way."""
    silicone = material("silskin_0")
    friction = interface_of("silskin_0")
    friction = InterfaceFriction(friction.tau0, friction.alpha, dynamic_ratio=0.85, weakening_distance=0.1)
    grid = PlateGrid((256, 384), 0.025, (2.0, 0.0))
    programme = SlideProgramme(press_time=0.5, speed=2.0, distance=4.0)
    loss = area_loss_for(12.0, 0.9, 0.85)
    states = press_and_slide(
        grid, silicone, friction, programme, shaft_stiffness=(30.0, 2.5), area_loss=loss
    )  # fmt: skip
    figure = Figure(figsize=(13, 6.2), layout="constrained")
    axes = figure.subplots(2, 4)
    stick = np.array([s.parameters["stick_ratio"] for s in states])
    pressed = int(np.argmax([s.time >= 0.5 for s in states]))
    chosen = [pressed, *(pressed + int(np.argmin(np.abs(stick[pressed:] - v))) for v in (0.75, 0.35)), len(states) - 1]
    for axis, i in zip(axes[0], chosen, strict=True):
        state = states[i]
        axis.imshow(state.state, extent=grid.extent[:2] + grid.extent[3:1:-1], cmap=LABELS, vmin=0, vmax=3)
        axis.set(
            title=f"t = {state.time:.2f} s, Q = {state.tangential_force[0]:.2f} N", xlabel="x [mm]", ylabel="y [mm]"
        )
        row = grid.shape[0] // 2
        axes[1, 0].plot(grid.x, 1e3 * state.traction[0, row], label=f"{state.time:.2f} s")
    axes[1, 0].set(xlabel="x [mm]", ylabel="tangential traction at y = 0 [kPa]")
    axes[1, 0].legend(frameon=False, fontsize=8, loc="upper right")
    time = np.array([s.time for s in states])
    way = np.clip(time - 0.5, 0, None) * 2.0
    for axis, values, label in (
        (axes[1, 1], [s.tangential_force[0] for s in states], "tangential force [N]"),
        (axes[1, 2], [s.nominal_contact_area for s in states], "contact area [mm^2]"),
        (axes[1, 3], stick, "stick ratio [1]"),
    ):
        axis.plot(way[pressed:], values[pressed:])
        axis.plot(way[chosen], np.array(values)[chosen], "o", ms=4)
        axis.set(xlabel="way of the drive [mm]", ylabel=label)
        axis.grid(alpha=0.3)
    return figure


def stick_slip() -> Figure:
    """Force and spectrum of a finger on a compliant drive, with the closed form's frequency."""
    slider = Slider(mass=0.05, stiffness=1.5, normal_force=1.0, static_friction=1.13, dynamic_friction=0.95)
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for i, speed in enumerate((1.0, 5.0, 25.0)):
        run = simulate_stick_slip(slider, speed, 20.0, 1000.0)
        shown = run.time < 1.5
        left.plot(run.time[shown], run.spring_force[shown], lw=0.9, color=f"C{i}", label=f"{speed:g} mm/s")
        late = run.time > 3.0
        found = spectrum(run.time[late], run.spring_force[late])
        right.loglog(found.frequency[1:], found.density[1:], lw=0.7, color=f"C{i}")
        right.axvline(1.0 / stick_slip_period(slider, speed), color=f"C{i}", ls="--", lw=1)
    left.set(xlabel="time [s]", ylabel="force of the spring [N]")
    left.legend(frameon=False)
    right.set(xlabel="frequency [Hz]", ylabel="power spectral density [N^2/Hz]", ylim=(1e-9, 1), xlim=(0.3, 300))
    right.set_title("dashed: closed form", fontsize=9)
    return figure


def viscoelastic() -> Figure:
    """Area under press, dwell and release, and force against depth, for both materials at 20 degC."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    time = np.concatenate([np.linspace(0, 0.2, 201), np.linspace(0.2, 1.2, 301)[1:], np.linspace(1.2, 1.4, 201)[1:]])
    force = np.interp(time, [0, 0.2, 1.2, 1.4], [0, 1, 1, 0])
    for name in ("silskin_0", "silskin_20"):
        history = press_by_force(time, force, 7.5, reduced_series(prony_of(name, 20.0), 0.49))
        area = np.pi * history.radius**2
        left.plot(time, area / area[200], label=f"{name}: {area[200]:.1f} mm^2 at the load")
        right.plot(history.depth, history.force, label=name)
    left.set(xlabel="time [s]", ylabel="contact area over area on reaching 1 N [1]")
    left.legend(frameon=False)
    right.set(xlabel="depth [mm]", ylabel="normal force [N]")
    right.legend(frameon=False)
    for axis in (left, right):
        axis.grid(alpha=0.3)
    return figure


def main() -> None:
    """Write the PNG files beside this script."""
    for name, draw in (("sliding", sliding), ("stick_slip", stick_slip), ("viscoelastic", viscoelastic)):
        (HERE / f"{name}.png").write_bytes(figure_png(draw(), dpi=90))


if __name__ == "__main__":
    main()
